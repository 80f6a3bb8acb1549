"""Recipe for slow walkers: the default with another step length."""

from dataclasses import dataclass, replace

import numpy as np

import pdr_filter as pdr


@dataclass(frozen=True)
class CadenceStepLength:
    """Step length a + b f, with f in steps a second and parameters a (m) and b (m s)."""

    n_params: int = 2

    def regressors(self, step: pdr.Step) -> np.ndarray:
        return np.array([1.0, step.frequency_hz])


def recipe(subject: pdr.recipes.Subject | None = None) -> pdr.Config:
    """Return the default for people who take 1.2 to 1.6 steps a second."""
    theta, theta_cov = np.array([0.05, 0.33]), np.diag([0.05, 0.03]) ** 2
    fit = pdr.StepLengthFit(CadenceStepLength(), theta, theta_cov, residual_std_m=0.07)
    return replace(pdr.recipes.default(subject).with_step_length("walking", fit), name="slow-walkers")
