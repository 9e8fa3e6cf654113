"""Programs for users: ``demo``, ``view`` and ``evaluate``. They may import every package of oes."""
