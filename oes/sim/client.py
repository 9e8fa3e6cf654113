"""One Bullet physics server inside this process, with its functions as attributes."""

from functools import partial
from typing import Any

import pybullet

BulletError: type[Exception] = pybullet.error


class Bullet:
    """``Bullet().stepSimulation()`` is ``pybullet.stepSimulation(physicsClientId=...)``.

    pybullet_utils' BulletClient does the same, but makes the server print its command line, and
    disconnects only on garbage collection.
    """

    def __init__(self) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)

    def __getattr__(self, name: str) -> Any:
        value = getattr(pybullet, name)
        bound = partial(value, physicsClientId=self._client) if callable(value) else value
        setattr(self, name, bound)  # looked up once: some functions are called at every step
        return bound
