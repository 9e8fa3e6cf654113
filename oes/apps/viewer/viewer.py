"""The 3D scene of a session in the browser (viser), with handles on the objects and the push."""

import threading
import time
from functools import partial
from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from oes.apps.viewer.panel import Panel, make_panel
from oes.apps.viewer.session import Session
from oes.counterfactual.edits import Scenario
from oes.counterfactual.forecast import ObjectMotion
from oes.episode import Episode, Floats
from oes.meshes.catalogue import Catalogue
from oes.sim.arm import ReachError
from oes.sim.client import BulletError
from oes.sim.world import SimConfig
from oes.viz.overlay import FORECAST, GOAL, PERCEIVED, PUSH, Colour

POINT_M, ROD_M, HANDLE_M = 0.006, 0.15, 0.09
PLAY_S = 0.5
ZOOM = 3
GREY = (120, 120, 120)


class Viewer:
    """Draws a session. Every interaction wakes one thread, which forecasts and draws the newest
    state, so that a slow forecast never queues up drags.
    """

    def __init__(
        self, server: viser.ViserServer, session: Session, catalogue: Catalogue, sim: SimConfig
    ) -> None:
        self.server, self.session, self.catalogue, self.sim = server, session, catalogue, sim
        self.cameras = [camera.name for camera in session.first.episode.steps[0].cameras]
        self.truth: Episode | None = session.first.episode
        self.latency_s = float("nan")
        self._requested_s = time.perf_counter()
        self._wake = threading.Event()
        self.panel = self._build_panel()
        self._build_scene()
        self._place_handles()
        self.update()
        threading.Thread(target=self._redraw_loop, daemon=True).start()

    def _build_panel(self) -> Panel:
        num_steps = len(self.session.first.episode.actions_T3)
        panel = make_panel(self.server.gui, self.cameras, self.session.camera_i, num_steps)
        panel.T.on_update(lambda _: self.redraw())
        panel.camera.on_update(lambda _: self.redraw())
        panel.simulate.on_click(lambda _: self.simulate())
        panel.restore.on_click(lambda _: self.restore())
        for name, box in panel.layers.items():
            box.on_update(partial(self._show, name))
        return panel

    def _build_scene(self) -> None:
        scene, session = self.server.scene, self.session
        shown = {name: box.value for name, box in self.panel.layers.items()}
        self.layers = {
            name: scene.add_frame(f"/{name}", show_axes=False, visible=shown[name])
            for name in shown
        }
        scene.set_up_direction("+z")
        self.server.initial_camera.position, self.server.initial_camera.look_at = (
            (0.5, -0.4, 0.42),
            (0.0, 0.0, 0.0),
        )
        scene.add_box("/table", (196, 174, 145), (0.6, 0.6, 0.02), position=(0, 0, -0.01))
        scene.add_point_cloud("/input/points", *session.input_points(), point_size=POINT_M / 2)
        scene.add_point_cloud("/map/points", *session.map_points(), point_size=POINT_M)
        self.moving, objects = [], session.first.scene.objects
        for i, (center, size) in enumerate(
            zip(objects.center_N3.numpy(), objects.size_N3.numpy(), strict=True)
        ):
            self._wire(f"/perceived/{i}", size, PERCEIVED, center)
            self.moving.append(scene.add_frame(f"/forecast/{i}", show_axes=False, position=center))
            scene.add_point_cloud(
                f"/forecast/{i}/points", *session.object_points(i), point_size=POINT_M
            )
            self._wire(f"/forecast/{i}/box", size, FORECAST, np.zeros(3))
        first = session.first.episode.steps[0]
        self.true = [
            self._wire(f"/truth/{i}", size, GOAL, place)
            for i, (place, size) in enumerate(zip(first.center_N3, first.size_N3, strict=True))
        ]
        self._build_cameras()

    def _build_cameras(self) -> None:
        for camera in self.session.first.episode.steps[0].cameras:
            fov = 2 * np.arctan(camera.height_px / 2 / camera.K_33[1, 1])
            pose = camera.world_T_cam_44
            shape = self.server.scene.add_camera_frustum(
                f"/cameras/{camera.name}",
                float(fov),
                camera.width_px / camera.height_px,
                scale=0.03,
                thickness=1.5,
                thickness_units="screen",
                color=GREY,
                wxyz=_wxyz(pose[:3, :3]),
                position=pose[:3, 3],
            )
            shape.on_click(partial(self._select_camera, camera.name))

    def _wire(self, name: str, size_3: Floats, colour: Colour, place_3: Floats) -> viser.BoxHandle:
        return self.server.scene.add_box(name, colour, size_3, wireframe=True, position=place_3)

    def _place_handles(self) -> None:
        """Put the handles at the recorded positions."""
        for i, center_3 in enumerate(self.session.first.scene.objects.center_N3.numpy()):
            handle = self._handle(f"/handles/{i}", center_3)
            handle.on_update(partial(self._on_drag, i))
        episode = self.session.first.episode
        if not episode.has_robot:
            return
        tip_3 = episode.steps[0].tip_world_3
        self.rod = self.server.scene.add_line_segments(
            "/push", np.zeros((1, 2, 3)), PUSH, thickness=0.004
        )
        self.start, self.end = (
            self._handle(f"/handles/{word}", place)
            for word, place in (("start", tip_3), ("end", tip_3 + episode.actions_T3.sum(0)))
        )
        self.start.on_update(lambda _: self._drag_push())
        self.end.on_update(lambda _: self._drag_push())

    def _handle(self, name: str, place_3: Floats) -> viser.TransformControlsHandle:
        return self.server.scene.add_transform_controls(
            name,
            scale=HANDLE_M,
            active_axes=(True, True, False),
            disable_rotations=True,
            depth_test=False,
            position=place_3,
        )

    def _on_drag(self, i: int, event: Any) -> None:
        self._drag(i, np.asarray(event.target.position))

    def _drag(self, i: int, place_3: Floats) -> None:
        first_3 = self.session.first.scene.objects.center_N3[i].double().numpy()
        self.session.change.shift_N3[i] = (place_3 - first_3) * [1, 1, 0]
        self._changed()

    def _drag_push(self) -> None:
        episode, change = self.session.first.episode, self.session.change
        start_3, end_3 = np.asarray(self.start.position), np.asarray(self.end.position)
        was, now = episode.actions_T3.sum(0), end_3 - start_3
        change.start_3 = (start_3 - episode.steps[0].tip_world_3) * [1, 1, 0]
        change.turn_rad = float(np.arctan2(now[1], now[0]) - np.arctan2(was[1], was[0]))
        self._changed()

    def _changed(self) -> None:
        self.truth = None
        self.redraw()

    def redraw(self) -> None:
        """Request a redraw."""
        if not self._wake.is_set():
            self._requested_s = time.perf_counter()
        self._wake.set()

    def simulate(self) -> None:
        """Simulate the change with Bullet; an error of the arm goes to the status line."""
        try:
            self.truth = self.session.simulated(self.catalogue, self.sim)
            self.redraw()
        except (ReachError, BulletError) as error:
            self.panel.status.content = f"The simulation failed: {error}"

    def restore(self) -> None:
        """Undo all changes."""
        self.session.change = self.session.unchanged()
        self._place_handles()
        self.truth = self.session.first.episode
        self.redraw()

    def _redraw_loop(self) -> None:
        while True:
            if self._wake.wait(PLAY_S if self.panel.play.value else None):
                self._wake.clear()
                self.update()
            elif self.panel.play.value:
                num_states = len(self.session.first.episode.actions_T3) + 1
                self.panel.T.value = (self.panel.T.value + 1) % num_states  # type: ignore[misc]

    def update(self) -> None:
        """Forecast, then draw the state at the selected time."""
        case, motion = self.session.forecast()
        T, panel = self.panel.T.value, self.panel
        self._draw_forecast(case, motion, T)
        self._draw_truth(T)
        camera_i = self.cameras.index(panel.camera.value)
        camera = case.episode.steps[T].cameras[camera_i]
        panel.rendered.image = _enlarged(self.session.render(case, motion, T, camera))
        if self.truth is self.session.first.episode:
            panel.recorded.image = _enlarged(self.session.recorded(T, camera_i)[0].rgb_VHW3[0])
        panel.recorded.visible = self.truth is self.session.first.episode
        self.latency_s = time.perf_counter() - self._requested_s
        panel.status.content = self._status(case, motion, T)

    def _status(self, case: Scenario, motion: ObjectMotion, T: int) -> str:
        error = (
            "not simulated yet"
            if self.truth is None
            else f"{self.session.error_mm(case, motion, self.truth, T):.0f} mm error"
        )
        return f"Forecast at T = {T}: {error}. Latency: {self.latency_s * 1e3:.0f} ms."

    def _draw_forecast(self, case: Scenario, motion: ObjectMotion, T: int) -> None:
        poses = motion.poses(case.poses, T)
        with self.server.atomic():
            for i, frame in enumerate(self.moving):
                frame.wxyz = _wxyz(poses.rotation_N33[i].double().numpy())
                frame.position = (self.session.scene.center_N3[i] + poses.translation_N3[i]).numpy()
            if case.episode.has_robot:
                tips = case.episode.steps[0].tip_world_3 + np.cumsum(
                    [np.zeros(3), *case.episode.actions_T3], axis=0
                )
                rod = np.stack([tips[T], tips[T] + np.array([0, 0, ROD_M])])
                self.rod.points = np.concatenate(
                    [np.stack([tips[:-1], tips[1:]], 1), rod[None]]
                ).astype(np.float32)

    def _draw_truth(self, T: int) -> None:
        with self.server.atomic():
            for i, box in enumerate(self.true):
                box.visible = self.truth is not None
                if self.truth is not None:
                    box.position, box.dimensions = (
                        self.truth.steps[T].center_N3[i],
                        self.truth.steps[T].size_N3[i],
                    )

    def _show(self, name: str, event: Any) -> None:
        self.layers[name].visible = event.target.value

    def _select_camera(self, name: str, _: Any) -> None:
        self.panel.camera.value = name  # type: ignore[misc]


def _wxyz(rotation_33: Floats) -> Floats:
    return Rotation.from_matrix(rotation_33).as_quat(scalar_first=True)


def _enlarged(pixels: np.ndarray) -> np.ndarray:
    return pixels.repeat(ZOOM, axis=0).repeat(ZOOM, axis=1)
