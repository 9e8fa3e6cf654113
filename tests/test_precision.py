"""Half precision only where it is wanted, and only where it is fast."""

import pytest
import torch

from oes.training import precision

CPU = torch.device("cpu")


@pytest.mark.parametrize(
    ("can", "wanted"), [(True, True), (True, False), (False, True), (False, False)]
)
def test_bfloat16_is_used_where_it_is_wanted_and_the_machine_has_it(
    monkeypatch: pytest.MonkeyPatch, can: bool, wanted: bool
) -> None:
    monkeypatch.setattr(precision, "has_bfloat16", lambda kind: can)
    with precision.half_precision(CPU, wanted):
        found = torch.ones(2, 2) @ torch.ones(2, 2)
    assert found.dtype == (torch.bfloat16 if can and wanted else torch.float32)
