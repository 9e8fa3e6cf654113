"""The browser viewer: state in ``session``, controls in ``panel``, the 3D scene in ``viewer``."""
