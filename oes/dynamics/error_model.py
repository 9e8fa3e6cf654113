"""How sure a forecast is: the spread of its draws, made into a scale of its error that held-out
episodes bear out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor

from oes.episode import Floats
from oes.metrics.errors import error_nll

MM_M = 1e-3
MIN_SIGMA_M = 3e-4  # of a scale: what rests settles by tenths of that, and a law made for it would be too sure of the rest
START_TAIL, LEAST_TAIL = 2.0, 0.5


@dataclass(frozen=True)
class ErrorModel:
    """The scale of an error (metres; see ``oes.metrics.errors.error_nll`` for the law, of tail
    ``tail``) is the root of the squares of ``floor_T`` and of ``gain`` times the spread of the
    draws. ``same_T`` and ``same_tail``: the best law that is the same for all objects, for
    comparison.
    """

    floor_T: tuple[float, ...]
    gain: float
    tail: float
    same_T: tuple[float, ...]
    same_tail: float

    def scale(self, spread_BTN: Tensor) -> Tensor:
        """Scales BTN (metres) of forecasts whose draws spread so far; steps beyond the known count
        as the last.
        """
        steps = spread_BTN.shape[1]
        floor_T = spread_BTN.new_tensor(
            [self.floor_T[min(t, len(self.floor_T) - 1)] for t in range(steps)]
        )
        return (floor_T[:, None].square() + (self.gain * spread_BTN).square()).sqrt()


def fit_error_model(error_TP: Floats, spread_TP: Floats) -> ErrorModel:
    """The certainty under which the errors of P held-out forecasts at T steps (metres) are
    likeliest.
    """
    steps = len(error_TP)
    found = _likeliest(
        error_TP,
        spread_TP,
        np.append(np.log(np.median(error_TP, 1) + MM_M), [0.0, np.log(START_TAIL)]),
    )
    same = _likeliest(error_TP, 0 * spread_TP, found)
    return ErrorModel(
        floor_T=tuple(np.exp(found[:steps]).tolist()),
        gain=float(np.exp(found[steps])),
        tail=LEAST_TAIL + float(np.exp(found[-1])),
        same_T=tuple(np.exp(same[:steps]).tolist()),
        same_tail=LEAST_TAIL + float(np.exp(same[-1])),
    )


def _likeliest(error_TP: Floats, spread_TP: Floats, start: Floats) -> Floats:
    """Logarithms of the floors T, of the gain and of the tail above the least."""
    steps = len(error_TP)

    def cost(x: NDArray[np.float64]) -> float:
        floor_T, gain = np.exp(x[:steps]), np.exp(x[steps])
        scale_TP = np.hypot(floor_T[:, None], gain * spread_TP)
        return float(
            np.mean(error_nll(error_TP / MM_M, scale_TP / MM_M, LEAST_TAIL + np.exp(x[-1])))
        )

    bounds = [(np.log(MIN_SIGMA_M), 0.0)] * steps + [(-5.0, 5.0), (-5.0, 5.0)]
    return np.asarray(minimize(cost, start, method="L-BFGS-B", bounds=bounds).x)


def errors_and_spreads(
    found_BTN3: Tensor, true_BTN3: Tensor, spread_BTN: Tensor, valid_BN: Tensor
) -> tuple[Floats, Floats]:
    """Errors TP and spreads TP (metres) of the valid objects of a batch, for
    ``fit_error_model``.
    """
    error_BTN = (found_BTN3 - true_BTN3).norm(dim=-1)
    error_TP, spread_TP = (
        part.movedim(1, 0)[:, valid_BN].double().numpy() for part in (error_BTN, spread_BTN)
    )
    return error_TP, spread_TP
