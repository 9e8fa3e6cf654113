"""Command lines of stages and apps: flags, params, logging and expected errors."""

import inspect
import logging
import signal
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Sequence
from typing import get_type_hints

from oes.config import PARAMS, load
from oes.episode import TASKS

log = logging.getLogger(__name__)


SPLITS = ("train", "test1", "test2", "test3", "test4", "test5")
FLAGS: dict[str, tuple[str, Sequence[str] | None]] = {
    "task": ("task of the episodes", TASKS),
    "split": ("split of the episodes; test splits are named by their number of objects", SPLITS),
    "model": ("name of the model", None),
    "scenario": ("a key of trials.scenarios in params.yaml", None),
    "out": ("folder to write; it appears whole", None),
    "meshes": ("output folder of the stage meshes", None),
    "episodes": ("output folder of the stage episodes, or one split in it", None),
    "perception": ("output folder of the stage perception", None),
    "objects": ("output folder of the stage objects, or one split in it", None),
    "dynamics": ("output folder of the stage dynamics, or one model in it", None),
    "overhead": ("output folder of the stage overhead", None),
    "rollouts": ("output folder of the stage rollouts", None),
    "futures": ("output folder of the stage futures", None),
    "trials": ("output folder of the stage trials", None),
}
"""Help and choices of the flags that stages share."""


def run(main: Callable[..., None]) -> None:
    """Call ``main(cfg, flag, ...)``: the entry point of every stage and app.

    ``cfg`` is the section of params.yaml with the module's name, of the type of main's first
    annotation. Every other argument is a command-line flag; one with a default is optional. Its
    help is the ``Annotated`` text of its annotation, or the entry of ``FLAGS``. An expected error
    (a subclass of ValueError, or a missing file) and ctrl-C end with one line and status 1; any
    other exception is a bug and keeps its traceback.
    """
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    module = spec.name if spec is not None and main.__module__ == "__main__" else main.__module__
    name = module.rpartition(".")[2]
    hints = get_type_hints(main, include_extras=True)
    cfg_name = next(iter(inspect.signature(main).parameters))
    given = vars(flag_parser(module, main).parse_args())
    logging.basicConfig(level=logging.WARNING, format=f"{name}: %(message)s")
    for package in ("oes", "stages", "__main__"):
        logging.getLogger(package).setLevel(logging.INFO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        main(load(PARAMS, name, hints[cfg_name]), **given)
    except KeyboardInterrupt:
        sys.exit(f"{name}: stopped; the next run resumes it")
    except (ValueError, FileNotFoundError) as error:
        if type(error) is ValueError:
            raise
        log.debug("%s failed", name, exc_info=True)
        sys.exit(f"{name}: {' '.join(str(error).split())}")


def flag_parser(module: str, main: Callable[..., None]) -> ArgumentParser:
    """The parser of the flags of ``main``, which runs as ``python -m module``."""
    parser = ArgumentParser(
        prog=f"python -m {module}", description=sys.modules[main.__module__].__doc__
    )
    hints = get_type_hints(main, include_extras=True)
    for name, parameter in list(inspect.signature(main).parameters.items())[1:]:
        kind, notes = hints[name], list(getattr(hints[name], "__metadata__", ()))
        kind = kind.__origin__ if notes else kind
        about, choices = FLAGS[name] if not notes else (notes[0], None)
        flag = f"--{name.replace('_', '-')}"
        if kind is bool:
            parser.add_argument(flag, action="store_true", help=about)
            continue
        is_required = parameter.default is parameter.empty
        parser.add_argument(
            flag,
            required=is_required,
            default=None if is_required else parameter.default,
            type=kind,
            choices=choices,
            metavar=None if choices else {str: "NAME", int: "N"}.get(kind, "PATH"),
            help=about if is_required else f"{about} (default: {parameter.default})",
        )
    return parser
