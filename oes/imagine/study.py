"""Imagined futures of some test episodes, measured and shown: rows for tables, pictures for people."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from oes.config import params
from oes.dynamics.unroll import Model
from oes.imagine.compose import Still
from oes.imagine.edits import KINDS, Edits
from oes.imagine.first import TRUTH, perceive, true_motions
from oes.imagine.gallery import Painter, write_pictures, write_predictions, zoomed
from oes.imagine.quality import Judge, Row
from oes.imagine.whatif import Answer, ask, edit_rows
from oes.meshes.catalogue import Catalogue
from oes.percept.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.sim.world import Sim

TABLES = ("renders", "consistency", "edits")


@params
class Futures:
    """The section ``futures``: which split of each task; of how many of its episodes changes are asked, how many are
    rendered and measured, how many shown; the times T of measures; the cameras to look through, in shown pictures with
    ``zoom``; the kinds of changes (of ``KINDS``); and Bullet."""

    seed: int
    num_workers: int
    splits: dict[str, str]
    count: int
    rendered: int
    times: tuple[int, ...]
    cameras: tuple[int, ...]
    zoom: float
    kinds: dict[str, tuple[str, ...]]
    edits: Edits
    shown: int
    sim: Sim

    def __post_init__(self) -> None:
        """Raises ValueError (a ParamsError when read from params.yaml) for an unknown kind of change."""
        unknown = sorted({kind for kinds in self.kinds.values() for kind in kinds} - KINDS.keys())
        if unknown:
            raise ValueError(f"kinds: unknown {', '.join(unknown)}; there are: {', '.join(KINDS)}")


@dataclass(frozen=True)
class Study:
    """What every episode is imagined with; ``models``: the one that is also seen from several sides comes first."""

    cfg: Futures
    task: str
    catalogue: Catalogue
    perceiver: Perceiver
    source: FrameSource
    models: Mapping[str, Model]

    def run(self, progress: Path, gallery: Path) -> dict[str, list[Row]]:
        """The rows of each of ``TABLES``; episodes already in ``progress`` are not done again."""
        count = min(self.cfg.count, len(self.source))
        paths = [progress / f"{episode_i:06d}.json" for episode_i in range(count)]
        jobs = [delayed(self._write)(i, path, gallery) for i, path in enumerate(paths) if not path.exists()]
        done = Parallel(n_jobs=self.cfg.num_workers, return_as="generator_unordered")(jobs)
        for _ in tqdm(done, total=len(jobs), desc=f"imagining {self.task}", unit="episode"):
            pass
        found = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
        return {name: [row for rows in found for row in rows.get(name, [])] for name in TABLES}

    def _write(self, episode_i: int, path: Path, gallery: Path) -> None:
        """One episode: its pictures first, then its rows, whole by rename."""
        rows = self.episode(episode_i, gallery)
        part = path.with_suffix(".part")
        part.write_text(json.dumps(rows), encoding="utf-8")
        part.replace(path)

    def episode(self, episode_i: int, gallery: Path) -> dict[str, list[Row]]:
        """The rows of one episode, seen at first by a camera drawn at random."""
        cfg, episode = self.cfg, self.source.episodes[episode_i]
        rng = np.random.default_rng((cfg.seed, episode_i))
        others = [i for i in range(len(episode.steps[0].cameras)) if i not in cfg.cameras]
        seen_is = rng.permutation(others).tolist()
        input_i = seen_is[0]
        case, still = perceive(self.perceiver, self.source, episode_i, input_i)
        world = (self.catalogue, cfg.sim, self.models)
        answers = list(ask(case, cfg.kinds[self.task], cfg.edits, still.window, rng, world))
        if episode_i < cfg.shown:
            cameras = [zoomed(episode.steps[0].cameras[i], cfg.zoom) for i in (input_i, *cfg.cameras)]
            painter = Painter(self.perceiver, self.catalogue, cfg.sim, still)
            write_pictures(painter, answers, cameras, list(self.models), gallery)
            path = gallery / f"prediction-{episode_i:06d}.png"
            write_predictions(self.perceiver, self.source, episode_i, (seen_is, cfg.cameras), path)
        judge = Judge(self.perceiver, self.source, case, (input_i, cfg.cameras))
        judged = self._judged(judge, still, answers[0]) if episode_i < cfg.rendered else {}
        return judged | {"edits": [row for answer in answers for row in edit_rows(answer, cfg.times)]}

    def _judged(self, judge: Judge, still: Still, answer: Answer) -> dict[str, list[Row]]:
        cfg, shown = self.cfg, next(iter(self.models))
        imagined = {**answer.found, TRUTH: true_motions(answer.case, answer.happened)}
        renders = [row for T in cfg.times for row in judge.renders(still, imagined, T, self.catalogue, cfg.sim)]
        again = [
            row
            for T in cfg.times
            for rows in (judge.consistency(still, shown, imagined[shown], T), judge.photographs(T))
            for row in rows
        ]
        return {"renders": renders, "consistency": again}
