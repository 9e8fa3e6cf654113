"""Predictive uncertainty: the spread of a model's samples, calibrated on held-out episodes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor

from oes.episode import Floats
from oes.metrics.errors import error_nll

MM_M = 1e-3
# Lower bound of sigma (metres): errors of resting objects are a tenth of it, and a distribution
# fitted to them would be overconfident about moving ones.
MIN_SIGMA_M = 3e-4
INITIAL_DOF, MIN_DOF = 2.0, 0.5


@dataclass(frozen=True)
class ErrorModel:
    """Distribution of translation errors: a 2D Student t (``oes.metrics.errors.error_quantile``).

    It has ``dof`` degrees of freedom and, at step t, sigma^2 = floor_T[t]^2 + (spread_gain *
    spread)^2 (metres). ``homoscedastic_sigma_T`` and ``homoscedastic_dof`` fit errors best when
    the spread is ignored, for comparison.
    """

    floor_T: tuple[float, ...]
    spread_gain: float
    dof: float
    homoscedastic_sigma_T: tuple[float, ...]
    homoscedastic_dof: float

    def sigma(self, spread_BTN: Tensor) -> Tensor:
        """Sigma BTN (metres) for spreads BTN; steps beyond the fitted ones use the last floor."""
        floor = [*self.floor_T, *self.floor_T[-1:] * spread_BTN.shape[1]][: spread_BTN.shape[1]]
        floor_T1 = spread_BTN.new_tensor(floor)[:, None]
        return (floor_T1.square() + (self.spread_gain * spread_BTN).square()).sqrt()


def fit_error_model(error_TP: Floats, spread_TP: Floats) -> ErrorModel:
    """Maximum-likelihood error model of P held-out forecasts over T steps (metres)."""
    steps = len(error_TP)
    initial = np.append(np.log(np.median(error_TP, 1) + MM_M), [0.0, np.log(INITIAL_DOF)])
    best = _minimize_nll(error_TP, spread_TP, initial)
    # Spreads of 0 leave the floors as the only scale.
    homoscedastic = _minimize_nll(error_TP, 0 * spread_TP, best)
    return ErrorModel(
        floor_T=tuple(np.exp(best[:steps]).tolist()),
        spread_gain=float(np.exp(best[steps])),
        dof=MIN_DOF + float(np.exp(best[-1])),
        homoscedastic_sigma_T=tuple(np.exp(homoscedastic[:steps]).tolist()),
        homoscedastic_dof=MIN_DOF + float(np.exp(homoscedastic[-1])),
    )


def _minimize_nll(error_TP: Floats, spread_TP: Floats, initial: Floats) -> Floats:
    """Logarithms of the T floors, of the spread gain and of dof - ``MIN_DOF``."""
    steps = len(error_TP)

    def mean_nll(x: NDArray[np.float64]) -> float:
        floor_T, spread_gain = np.exp(x[:steps]), np.exp(x[steps])
        sigma_TP = np.hypot(floor_T[:, None], spread_gain * spread_TP)
        return float(np.mean(error_nll(error_TP / MM_M, sigma_TP / MM_M, MIN_DOF + np.exp(x[-1]))))

    # Logarithms keep all parameters positive.
    bounds = [(np.log(MIN_SIGMA_M), 0.0)] * steps + [(-5.0, 5.0), (-5.0, 5.0)]
    return np.asarray(minimize(mean_nll, initial, method="L-BFGS-B", bounds=bounds).x)


def errors_and_spreads(
    predicted_BTN3: Tensor, true_BTN3: Tensor, spread_BTN: Tensor, valid_BN: Tensor
) -> tuple[Floats, Floats]:
    """Errors TP and spreads TP (metres) of a batch's P valid objects, for ``fit_error_model``."""
    error_BTN = (predicted_BTN3 - true_BTN3).norm(dim=-1)
    error_TP, spread_TP = (x.movedim(1, 0)[:, valid_BN] for x in (error_BTN, spread_BTN))
    return error_TP.double().numpy(), spread_TP.double().numpy()
