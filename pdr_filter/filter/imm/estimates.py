"""Estimates of the filters of a tracker, including errors that are not part of the filter states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.imm import imm
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.values import FloatArray, make_read_only

# Rows of `consider_error_m`.
ALONG_AND_ACROSS, LENGTH_PARAMETERS = slice(2), slice(2, None)


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of F filters: one for each mode with weighting `imm`, a single one with `hc` and `wc`.

    Attributes
    ----------
    mean : (F, 4) array
        Means of the states (east in m, north in m, heading offset in rad, log step scale).
    cov : (F, 4, 4) array
        Covariances of the states.
    prob : (F,) array
        Probability of each filter.
    walked_m : (F,) array
        Expected distance in m of all steps so far, given that the mode of the filter holds at the last step.
    consider_error_m : (2 + M, 2) array
        Error of the position in m for one standard deviation of each consider parameter (see `consider_cov_m2`). Rows 0
        and 1 are the errors along and across the steps, the others the length parameters of each of the M modes.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.estimates import Estimates
    >>> mean, cov = np.array([[0.0, 0, 0, 0], [1, 0, 0, 0]]), np.tile(0.01 * np.eye(4), (2, 1, 1))
    >>> estimates = Estimates(mean, cov, np.array([0.5, 0.5]), np.array([0.0, 1.0]), np.zeros((4, 2)))
    >>> x, P = estimates.combined
    >>> float(x[0]), round(float(P[0, 0]), 2), estimates.distance_m
    (0.5, 0.26, 0.5)
    """

    mean: FloatArray
    cov: FloatArray
    prob: FloatArray
    walked_m: FloatArray
    consider_error_m: FloatArray

    @property
    def combined(self) -> tuple[FloatArray, FloatArray]:
        """Mean (4,) and covariance (4, 4) of the mixture of all filters."""
        return imm.combine(self.mean, self.cov, self.prob)

    @property
    def distance_m(self) -> float:
        """Expected distance in m of all steps so far."""
        return float(self.prob.dot(self.walked_m))

    @property
    def heading_var_rad2(self) -> float:
        """Mean over the filters of the variance of the heading offset, in rad2."""
        return float(self.prob.dot(self.cov[:, HEADING_OFFSET, HEADING_OFFSET]))

    @property
    def consider_cov_m2(self) -> FloatArray:
        """Covariance (2, 2) that the consider parameters add to the covariance of the position, in m2.

        Notes
        -----
        A consider parameter is a constant that a filter does not estimate, but whose uncertainty is part of its
        covariance (the Schmidt-Kalman filter). Let S be the derivative of the position with respect to the parameters
        and C the covariance of the parameters. Then S C S' is added to the covariance of the position. The rows of
        `consider_error_m` are the columns of S C^(1/2). They are summed over the steps as vectors and not as variances,
        because a parameter has the same error in all steps of a person. If the errors were taken as independent, the
        standard deviation after 300 steps would be ten times too small.

        The parameters are the second-order errors along and across the steps (`motion_model.second_order_errors`) and,
        for each mode, the parameters of its length model. A used position fix transfers this covariance to the
        covariance of the states (`fix_updates`). Schmidt's filter would instead keep the covariance between parameters
        and states.

        References
        ----------
        S. F. Schmidt, "Application of state-space methods to navigation problems", Advances in Control Systems 3, 1966.

        B. D. Tapley, B. E. Schutz, G. H. Born, "Statistical Orbit Determination", 2004, chapter 6.
        """
        return self.consider_error_m.T.dot(self.consider_error_m)

    @property
    def length_parameters_cov_m2(self) -> FloatArray:
        """Part (2, 2) of `consider_cov_m2` that is due to the parameters of the length models."""
        error_m = self.consider_error_m[LENGTH_PARAMETERS]
        return error_m.T @ error_m


def position_cov(P: FloatArray, consider_cov_m2: FloatArray) -> FloatArray:
    """Return the covariance (2, 2) of a position in m2, including the consider parameters.

    Consider parameters are errors that all steps share and that the filter does not estimate. P (4, 4) is the
    covariance of the state, and `consider_cov_m2` (2, 2) the covariance of the position due to the consider parameters.
    """
    (xx, xy, _, _), (yx, yy, _, _) = P[:2].tolist()
    (consider_xx, consider_xy), (_, consider_yy) = consider_cov_m2.tolist()
    xy = 0.5 * (xy + yx) + consider_xy
    return make_read_only(np.array(((xx + consider_xx, xy), (xy, yy + consider_yy))))
