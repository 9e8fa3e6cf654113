"""One Bullet physics server inside this process, its functions as attributes."""

from functools import partial
from typing import Any

import pybullet

BulletError: type[Exception] = pybullet.error


class Bullet:
    """``Bullet().stepSimulation()`` is ``pybullet.stepSimulation(physicsClientId=...)`` of its own
    server.

    As pybullet_utils' BulletClient, which however makes the server print its command line and
    leaves it to the garbage collector to disconnect.
    """

    def __init__(self) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)

    def __getattr__(self, name: str) -> Any:
        value = getattr(pybullet, name)
        bound = partial(value, physicsClientId=self._client) if callable(value) else value
        setattr(self, name, bound)
        return bound
