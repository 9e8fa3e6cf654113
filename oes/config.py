"""params.yaml: one section becomes one frozen, strictly typed dataclass.

Every setting stands once, in params.yaml; Python has no defaults. An unknown or missing key and a
wrong type are errors that name the file and the dotted key: ``params.yaml: rollouts.moved_mm``.
"""

import dataclasses
import json
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import yaml
from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from pydantic_core import ErrorDetails

Params = TypeVar("Params")

SHARED = "a section of its own"
Shared = Annotated[Params, SHARED]
"""Type of a field whose value stands once in params.yaml, in a section named like the field."""

PARAMS = Path("params.yaml")
KEY_ERRORS = {"unexpected_keyword_argument": "unknown key", "missing": "missing"}


class ParamsError(ValueError):
    """A params section, or a config stored with weights, that does not fit its dataclass."""


@typing.dataclass_transform(frozen_default=True)
def params(cls: type[Params]) -> type[Params]:
    """Make a class a frozen dataclass that refuses unknown keys, missing keys and wrong types."""
    config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
    made: Any = dataclass(frozen=True, config=config)(cls)
    return cast(type[Params], made)


def shared_sections(cls: type) -> list[str]:
    """Names of the ``Shared`` fields of a section's class."""
    hints = typing.get_type_hints(cls, include_extras=True)
    return [name for name, hint in hints.items() if SHARED in getattr(hint, "__metadata__", ())]


def load(path: Path, section: str, cls: type[Params]) -> Params:
    """Read one section of a YAML file into ``cls``. YAML lists become tuples and ints pass as
    floats; text is never converted. A ``Shared`` field is filled from the section of its name.

    Raises ParamsError naming the file, the dotted key, the problem and, for a stray or missing
    key, the valid ones.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParamsError(
            f"{path}: not readable as YAML: {' '.join(str(error).split())}"
        ) from error
    if not isinstance(content, dict) or section not in content:
        raise ParamsError(f"{path}: has no section '{section}'; it has: {_listed(content)}")
    values = content[section]
    for name in shared_sections(cls):
        if name not in content:
            raise ParamsError(f"{path}: has no section '{name}'; it has: {_listed(content)}")
        if name in values:
            raise ParamsError(f"{path}: {section}.{name}: set it in the section '{name}'")
        values = {**values, name: content[name]}
    try:
        text = json.dumps(values, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ParamsError(f"{path}: {section}: {error}") from error
    return _validated(text, cls, str(path), section)


def to_json(cfg: object) -> str:
    """A params dataclass as JSON, keys in the order of its fields."""
    return TypeAdapter(type(cfg)).dump_json(cfg).decode()


def from_json(text: str, cls: type[Params], source: str = "stored config") -> Params:
    """Inverse of ``to_json``. Raises ParamsError naming ``source`` if the text does not fit."""
    return _validated(text, cls, source, "")


def _validated(text: str, cls: type[Params], source: str, section: str) -> Params:
    try:
        return TypeAdapter(cls).validate_json(text)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        problems = [_problem(details, section) for details in errors]
        wrong_keys = [details["loc"] for details in errors if details["type"] in KEY_ERRORS]
        valid = [_valid_keys(cls, loc[:-1], section) for loc in wrong_keys]
        raise ParamsError(f"{source}: " + "; ".join(dict.fromkeys(problems + valid))) from error


def _problem(details: ErrorDetails, section: str) -> str:
    """One error of pydantic as ``section.key: problem``."""
    where = _dotted(section, details["loc"])
    if details["type"] in KEY_ERRORS:
        return f"{where}: {KEY_ERRORS[details['type']]}"
    message = details["msg"].removeprefix("Value error, ")
    found = details["input"]
    if isinstance(found, str) and _is_number(found):
        message += ", and YAML reads this as text: write it like 1.0e-3"
    shown = "" if isinstance(found, Mapping) else f" (found {found!r})"
    return f"{where}: {message}{shown}" if where else f"{message}{shown}"


def _valid_keys(cls: Any, loc: Sequence[int | str], section: str) -> str:
    """The keys of the dataclass that ``loc`` leads to from ``cls``."""
    for part in loc:
        cls = _inside(cls, part)
    fields = dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ()
    names = ", ".join(field.name for field in fields) or "(none)"
    return f"valid keys{' of ' if section or loc else ''}{_dotted(section, loc)}: {names}"


def _dotted(section: str, loc: Sequence[int | str]) -> str:
    return ".".join(str(part) for part in (section, *loc) if part != "")


def _inside(cls: Any, part: int | str) -> Any:
    """Type of a member of ``cls``: a dataclass's field, or an item of a dict, tuple or union."""
    if dataclasses.is_dataclass(cls):
        return typing.get_type_hints(cls).get(str(part))
    args = typing.get_args(cls)
    if typing.get_origin(cls) is dict:
        return args[1]
    return next(
        (arg for arg in args if dataclasses.is_dataclass(arg) or typing.get_args(arg)), None
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _listed(content: object) -> str:
    return ", ".join(map(str, content)) if isinstance(content, dict) else "nothing"
