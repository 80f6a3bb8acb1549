"""Estimates of the filters of a tracker, with the consider covariance of errors that are not in their states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.imm import imm
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.values import FloatArray, frozen

# Rows of the consider parameters: along and across the step, then one for the length parameters of each mode.
ALONG_AND_ACROSS, LENGTH_PARAMETERS = slice(2), slice(2, None)


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of F filters: one for each mode with `imm`, one alone with `hc` and `wc`."""

    mean: FloatArray  # (F, 4)
    cov: FloatArray  # (F, 4, 4)
    prob: FloatArray  # (F,) of each filter
    walked_m: FloatArray  # (F,) expected distance of all steps so far, if each filter is right about the last of them
    consider_error_m: FloatArray  # (2 + M, 2) of the position, see `consider_cov_m2`

    @property
    def combined(self) -> tuple[FloatArray, FloatArray]:
        """Mean (4,) and covariance (4, 4) of all filters together."""
        return imm.combine(self.mean, self.cov, self.prob)

    @property
    def distance_m(self) -> float:
        """Expected distance of all steps so far."""
        return float(self.prob.dot(self.walked_m))

    @property
    def heading_var_rad2(self) -> float:
        """Mean variance of the heading offset, over all filters."""
        return float(self.prob.dot(self.cov[:, HEADING_OFFSET, HEADING_OFFSET]))

    @property
    def consider_cov_m2(self) -> FloatArray:
        """Covariance (2, 2) that the consider parameters add to that of the position.

        A consider parameter is a constant that a filter does not estimate, but whose uncertainty is part of its
        covariance (the Schmidt-Kalman filter: S. F. Schmidt, "Application of state-space methods to navigation
        problems", Advances in Control Systems 3, 1966; B. D. Tapley, B. E. Schutz and G. H. Born, "Statistical Orbit
        Determination", 2004, chapter 6). With S the derivative of the position with respect to the parameters and C
        their covariance, S C S' adds to the position's own covariance. The rows of `consider_error_m` are the columns
        of S C^(1/2): the error of the position for one standard deviation of each parameter. They add up over the steps
        as vectors, not as variances, because a parameter has the same error in all steps of a person. With independent
        errors a run of 300 steps would have a standard deviation ten times too small.

        The parameters are the second-order errors along and across the steps (`motion_model.second_order_errors`), and
        for each mode those of its length model. A used position fix moves this covariance into that of the states
        (`fix_updates`), where Schmidt's filter would keep the covariance of parameters and states.
        """
        return self.consider_error_m.T.dot(self.consider_error_m)

    @property
    def length_parameters_cov_m2(self) -> FloatArray:
        """Part (2, 2) of `consider_cov_m2` that is due to the parameters of the length models."""
        error_m = self.consider_error_m[LENGTH_PARAMETERS]
        return error_m.T @ error_m


def position_cov(P: FloatArray, consider_cov_m2: FloatArray) -> FloatArray:
    """Covariance (2, 2) of a position with linear covariance P (4, 4) and that of the consider parameters (2, 2)."""
    (xx, xy, _, _), (yx, yy, _, _) = P[:2].tolist()
    (consider_xx, consider_xy), (_, consider_yy) = consider_cov_m2.tolist()
    xy = 0.5 * (xy + yx) + consider_xy
    return frozen(np.array(((xx + consider_xx, xy), (xy, yy + consider_yy))))
