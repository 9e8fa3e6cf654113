"""Machine code that is kept: never older than what it calls."""

from pathlib import Path

from oes.jit import cache_dir


def test_code_is_kept_apart_for_every_state_of_the_sources_of_compiled_functions(
    tmp_path: Path,
) -> None:
    (tmp_path / "a.py").write_text("@jit\ndef f(): return g()\n")
    (tmp_path / "b.py").write_text("@jit\ndef g(): return 1\n")
    (tmp_path / "c.py").write_text("nothing = 0\n")
    first = cache_dir(tmp_path)
    assert first.parent == tmp_path / "__pycache__" and cache_dir(tmp_path) == first
    (tmp_path / "c.py").write_text("nothing = 1\n")
    assert cache_dir(tmp_path) == first, "nothing compiled has changed"
    (tmp_path / "b.py").write_text("@jit\ndef g(): return 2\n")
    assert cache_dir(tmp_path) != first, "f calls g"


def test_a_change_of_a_named_tuple_changes_the_folder(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("@jit\ndef f(x): return x.a\n")
    (tmp_path / "b.py").write_text("class Pair(NamedTuple):\n    a: int\n")
    first = cache_dir(tmp_path)
    (tmp_path / "b.py").write_text("class Pair(NamedTuple):\n    b: int\n    a: int\n")
    assert cache_dir(tmp_path) != first
