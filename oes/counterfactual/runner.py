"""Futures of test episodes: rows for the tables, and a gallery of the first ones."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oes.config import Shared, params
from oes.counterfactual import forecast
from oes.counterfactual.edits import EDIT_TYPES, EditsConfig
from oes.counterfactual.evaluate import FutureEvaluator, FutureRow, edit_rows
from oes.counterfactual.forecast import Counterfactual
from oes.counterfactual.gallery import FutureRenderer, write_gallery, write_predictions, zoomed
from oes.dynamics.unroll import DynamicsModel
from oes.episodes.capture import scene_renderer
from oes.meshes.catalogue import Catalogue
from oes.perception.perceiver import Perceiver
from oes.progress import resumable_map
from oes.record.dataset import FrameSource
from oes.schema import FUTURES
from oes.sim.world import SimConfig


@params
class FuturesConfig:
    """The section ``futures``.

    ``splits``, ``edit_types``: by task. ``num_episodes``: episodes that are edited and forecast,
    of which the first ``num_rendered`` are rendered and measured, and the first ``num_shown``
    shown. ``horizons_steps``: T of the measures. ``cameras``: indices of the query cameras.
    ``zoom``: of the gallery.
    """

    seed: int
    num_workers: int
    splits: dict[str, str]
    num_episodes: int
    num_rendered: int
    horizons_steps: tuple[int, ...]
    cameras: tuple[int, ...]
    zoom: float
    edit_types: dict[str, tuple[str, ...]]
    edits: EditsConfig
    num_shown: int
    sim: Shared[SimConfig]

    def __post_init__(self) -> None:
        """Raises ValueError (a ParamsError when read from params.yaml) for an unknown edit type."""
        unknown = {edit for edits in self.edit_types.values() for edit in edits} - {*EDIT_TYPES}
        if unknown:
            names = ", ".join(sorted(unknown))
            raise ValueError(f"edit_types: unknown {names}; valid: {', '.join(EDIT_TYPES)}")


@dataclass(frozen=True)
class FuturesRunner:
    """Inputs common to all episodes; the first of ``models`` is rendered from all cameras."""

    cfg: FuturesConfig
    task: str
    catalogue: Catalogue
    perceiver: Perceiver
    source: FrameSource
    models: Mapping[str, DynamicsModel]

    def run(self, progress: Path, gallery: Path) -> dict[str, list[FutureRow]]:
        """Rows by table (``oes.schema.FUTURES``); reuses episodes already in ``progress``."""
        cfg, count = self.cfg, min(self.cfg.num_episodes, len(self.source))
        paths = {progress / f"{episode_i:06d}.json": episode_i for episode_i in range(count)}

        def make(episode_i: int, path: Path) -> None:
            path.write_text(json.dumps(self.run_episode(episode_i, gallery)), encoding="utf-8")

        desc = f"futures {self.task}"
        resumable_map(make, paths, num_workers=cfg.num_workers, desc=desc, unit="episode")
        done = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
        return {name: [row for rows in done for row in rows.get(name, [])] for name in FUTURES}

    def run_episode(self, episode_i: int, gallery: Path) -> dict[str, list[FutureRow]]:
        """The rows of one episode, perceived by a random camera that is not a query camera."""
        cfg, episode = self.cfg, self.source.episodes[episode_i]
        rng = np.random.default_rng((cfg.seed, episode_i))
        num_cameras = len(episode.steps[0].cameras)
        input_is = rng.permutation([i for i in range(num_cameras) if i not in cfg.cameras]).tolist()
        views = self.perceiver, self.source
        scenario, scene = forecast.perceive_first_state(*views, episode_i, input_is[0])
        world = (self.catalogue, cfg.sim, self.models)
        edits = cfg.edit_types[self.task], cfg.edits
        futures = list(forecast.run_counterfactuals(scenario, *edits, scene.window, rng, world))
        tables: dict[str, list[FutureRow]] = {}
        if episode_i < cfg.num_rendered:
            evaluator = FutureEvaluator(*views, scenario, scene, input_is[0], cfg.cameras)
            tables = self._evaluate(evaluator, futures[0])
        if episode_i < cfg.num_shown:
            cameras = episode.steps[0].cameras
            shown = [zoomed(cameras[i], cfg.zoom) for i in (input_is[0], *cfg.cameras)]
            renderer = FutureRenderer(self.perceiver, self.catalogue, cfg.sim, scene)
            write_gallery(renderer, futures, shown, list(self.models), gallery)
            path = gallery / f"prediction-{episode_i:06d}.png"
            write_predictions(*views, episode_i, (input_is, cfg.cameras), path)
        rows = [row for future in futures for row in edit_rows(future, cfg.horizons_steps)]
        return {**tables, "edits": rows}

    def _evaluate(
        self, evaluator: FutureEvaluator, future: Counterfactual
    ) -> dict[str, list[FutureRow]]:
        renderer = scene_renderer(future.simulated, self.catalogue, self.cfg.sim)
        motions = dict(future.forecasts)
        motions[forecast.TRUTH] = forecast.true_motions(future.scenario, future.simulated)
        name = next(iter(self.models))
        rows: dict[str, list[FutureRow]] = {"renders": [], "consistency": []}
        for T in self.cfg.horizons_steps:
            rows["renders"] += evaluator.renders(motions, T, renderer)
            rows["consistency"] += evaluator.consistency(name, motions[name], T)
            rows["consistency"] += evaluator.detector_baseline(T)
        return rows
