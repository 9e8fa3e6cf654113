"""Imagined futures of some test episodes, measured and shown: rows for tables, pictures for
people.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from oes.config import Shared, params
from oes.counterfactual.compose import DecomposedScene
from oes.counterfactual.counterfactuals import Counterfactual, edit_rows, run_counterfactual
from oes.counterfactual.edits import EDIT_SAMPLERS, EditsConfig
from oes.counterfactual.evaluate import FutureEvaluator, FutureRow
from oes.counterfactual.forecast import TRUTH, perceive_first_state, true_motions
from oes.counterfactual.gallery import FutureRenderer, write_pictures, write_predictions, zoomed
from oes.dynamics.unroll import DynamicsModel
from oes.meshes.catalogue import Catalogue
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.sim.world import SimConfig

FUTURES_TABLES = ("renders", "consistency", "edits")


@params
class FuturesConfig:
    """The section ``futures``: which split of each task; of how many of its episodes changes are
    asked, how many are rendered and measured, how many shown; the times T of measures; the cameras
    to look through, in shown pictures with ``zoom``; the kinds of changes (of ``EDIT_SAMPLERS``);
    and Bullet.
    """

    seed: int
    num_workers: int
    splits: dict[str, str]
    count: int
    rendered: int
    times: tuple[int, ...]
    cameras: tuple[int, ...]
    zoom: float
    kinds: dict[str, tuple[str, ...]]
    edits: EditsConfig
    shown: int
    sim: Shared[SimConfig]

    def __post_init__(self) -> None:
        """Raises ValueError (a ParamsError when read from params.yaml) for an unknown kind of
        change.
        """
        unknown = sorted(
            {kind for kinds in self.kinds.values() for kind in kinds} - EDIT_SAMPLERS.keys()
        )
        if unknown:
            raise ValueError(
                f"kinds: unknown {', '.join(unknown)}; there are: {', '.join(EDIT_SAMPLERS)}"
            )


@dataclass(frozen=True)
class FuturesRunner:
    """What every episode is imagined with; ``models``: the one that is also seen from several sides
    comes first.
    """

    cfg: FuturesConfig
    task: str
    catalogue: Catalogue
    perceiver: Perceiver
    source: FrameSource
    models: Mapping[str, DynamicsModel]

    def run(self, progress: Path, gallery: Path) -> dict[str, list[FutureRow]]:
        """The rows of each of ``FUTURES_TABLES``; episodes already in ``progress`` are not done
        again.
        """
        count = min(self.cfg.count, len(self.source))
        paths = [progress / f"{episode_i:06d}.json" for episode_i in range(count)]
        jobs = [
            delayed(self._write)(i, path, gallery)
            for i, path in enumerate(paths)
            if not path.exists()
        ]
        done = Parallel(n_jobs=self.cfg.num_workers, return_as="generator_unordered")(jobs)
        for _ in tqdm(done, total=len(jobs), desc=f"imagining {self.task}", unit="episode"):
            pass
        found = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
        return {
            name: [row for rows in found for row in rows.get(name, [])] for name in FUTURES_TABLES
        }

    def _write(self, episode_i: int, path: Path, gallery: Path) -> None:
        """One episode: its pictures first, then its rows, whole by rename."""
        rows = self.episode(episode_i, gallery)
        part = path.with_suffix(".part")
        part.write_text(json.dumps(rows), encoding="utf-8")
        part.replace(path)

    def episode(self, episode_i: int, gallery: Path) -> dict[str, list[FutureRow]]:
        """The rows of one episode, seen at first by a camera drawn at random."""
        cfg, episode = self.cfg, self.source.episodes[episode_i]
        rng = np.random.default_rng((cfg.seed, episode_i))
        others = [i for i in range(len(episode.steps[0].cameras)) if i not in cfg.cameras]
        seen_is = rng.permutation(others).tolist()
        input_i = seen_is[0]
        case, still = perceive_first_state(self.perceiver, self.source, episode_i, input_i)
        world = (self.catalogue, cfg.sim, self.models)
        answers = list(
            run_counterfactual(case, cfg.kinds[self.task], cfg.edits, still.window, rng, world)
        )
        if episode_i < cfg.shown:
            cameras = [
                zoomed(episode.steps[0].cameras[i], cfg.zoom) for i in (input_i, *cfg.cameras)
            ]
            painter = FutureRenderer(self.perceiver, self.catalogue, cfg.sim, still)
            write_pictures(painter, answers, cameras, list(self.models), gallery)
            path = gallery / f"prediction-{episode_i:06d}.png"
            write_predictions(self.perceiver, self.source, episode_i, (seen_is, cfg.cameras), path)
        judge = FutureEvaluator(self.perceiver, self.source, case, (input_i, cfg.cameras))
        judged = self._judged(judge, still, answers[0]) if episode_i < cfg.rendered else {}
        return judged | {
            "edits": [row for answer in answers for row in edit_rows(answer, cfg.times)]
        }

    def _judged(
        self, judge: FutureEvaluator, still: DecomposedScene, answer: Counterfactual
    ) -> dict[str, list[FutureRow]]:
        cfg, shown = self.cfg, next(iter(self.models))
        imagined = {**answer.found, TRUTH: true_motions(answer.case, answer.happened)}
        renders = [
            row
            for T in cfg.times
            for row in judge.renders(still, imagined, T, self.catalogue, cfg.sim)
        ]
        again = [
            row
            for T in cfg.times
            for rows in (judge.consistency(still, shown, imagined[shown], T), judge.photographs(T))
            for row in rows
        ]
        return {"renders": renders, "consistency": again}
