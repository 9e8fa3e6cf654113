"""Counterfactual futures: edited scenes, forecast, rendered from any camera, and compared with
Bullet (paper 3.2, 4 and A).

May import perception, dynamics, evaluation, sim and render; not mpc or trials. Start with
``edits`` (changes of a scenario), then ``compose`` (objects moved in the map) and ``runner``.
"""
