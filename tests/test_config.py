"""params.yaml is read strictly, and every refusal names the key."""

import dataclasses
from pathlib import Path
from typing import Literal

import pytest

from oes.config import ParamsError, from_json, load, params, to_json


@params
class Split:
    count: int
    margin_m: float


@params
class Arm:
    noise_m: float
    bins: tuple[int, ...]
    kind: Literal["rod", "hand"]
    is_slow: bool
    splits: dict[str, Split]


GOOD = (
    "arm: {noise_m: 1, bins: [1, 2], kind: rod, is_slow: false, "
    "splits: {train: {count: 3, margin_m: 1.0e-3}}}"
)


def read(tmp_path: Path, text: str) -> Arm:
    path = tmp_path / "params.yaml"
    path.write_text(text, encoding="utf-8")
    return load(path, "arm", Arm)


def test_lists_become_tuples_and_ints_floats(tmp_path: Path) -> None:
    cfg = read(tmp_path, GOOD)
    assert cfg == Arm(1.0, (1, 2), "rod", False, {"train": Split(3, 0.001)})
    assert isinstance(cfg.noise_m, float)
    with pytest.raises(dataclasses.FrozenInstanceError):
        cfg.noise_m = 2.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("old", "new", "complaints"),
    [
        (
            "noise_m: 1,",
            "",
            ["arm.noise_m: missing", "valid keys of arm: noise_m, bins, kind, is_slow, splits"],
        ),
        ("noise_m: 1,", "noise_m: 1, noize_m: 2,", ["arm.noize_m: unknown key", "noise_m, bins"]),
        ("noise_m: 1,", "noise_m: 1e-3,", ["arm.noise_m", "1.0e-3", "'1e-3'"]),
        ("noise_m: 1,", "noise_m: '1',", ["arm.noise_m", "text"]),
        ("noise_m: 1,", "noise_m: .nan,", ["arm"]),
        ("noise_m: 1,", "noise_m: 2026-11-22,", ["arm", "date"]),
        ("noise_m: 1,", "noise_m: true,", ["arm.noise_m", "True"]),
        ("[1, 2]", "[1, 2.5]", ["arm.bins.1", "2.5"]),
        ("[1, 2]", "3", ["arm.bins", "(found 3)"]),
        ("rod", "claw", ["arm.kind", "'rod' or 'hand'", "'claw'"]),
        ("is_slow: false", "is_slow: 0", ["arm.is_slow", "boolean"]),
        (
            "count: 3",
            "count: 3.0, extra: 1",
            [
                "arm.splits.train.extra: unknown key",
                "valid keys of arm.splits.train: count, margin_m",
            ],
        ),
        (
            "count: 3, ",
            "",
            ["arm.splits.train.count: missing; valid keys of arm.splits.train: count, margin_m"],
        ),
        ("arm:", "leg:", ["no section 'arm'", "leg"]),
        (GOOD, "", ["no section 'arm'"]),
        ("[1, 2]", "[1, 2", ["not readable as YAML"]),
    ],
)
def test_every_refusal_names_file_and_key(
    tmp_path: Path, old: str, new: str, complaints: list[str]
) -> None:
    with pytest.raises(ParamsError) as caught:
        read(tmp_path, GOOD.replace(old, new))
    for part in ["params.yaml", *complaints]:
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_json_round_trip_and_foreign_metadata(tmp_path: Path) -> None:
    cfg = read(tmp_path, GOOD)
    assert from_json(to_json(cfg), Arm) == cfg
    with pytest.raises(
        ParamsError, match=r"model\.safetensors: .*count: missing; valid keys: count, margin_m"
    ):
        from_json('{"margin_m": 1.0}', Split, "model.safetensors")
    with pytest.raises(ParamsError, match="JSON"):
        from_json("not json", Split)
