"""Figures that compare probabilities and covariances with the actual errors."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from pdr_filter.apps.report.palette import BLUE, FAINT, INK
from pdr_filter.apps.report.plot.figures import add_grid, given_or_new
from pdr_filter.classifiers import probability_calibration
from pdr_filter.values import BoolArray, FloatArray

_MOST_BINS = 40


def reliability(prob: FloatArray, correct: BoolArray, ax: Axes | None = None, n_bins: int = 15) -> Axes:
    """Draw a reliability diagram: accuracy of predictions against their confidence.

    The area of a dot is the share of predictions in its bin. Dots on the diagonal are calibrated: predictions with a
    confidence of 0.8 are correct in 80 % of the cases. The figure states the expected calibration error.

    Parameters
    ----------
    prob : ndarray of shape (N, K)
        Predicted probabilities of K classes.
    correct : ndarray of bool, shape (N,)
        Whether the most probable class is the true one.
    ax : matplotlib Axes, optional
        Axes to draw into. By default a new figure is created.
    n_bins : int, default 15
        Number of confidence bins.

    Returns
    -------
    matplotlib Axes
        `ax`, or the axes of the new figure (`ax.figure`).

    See Also
    --------
    pdr_filter.evaluate.calibration_error : Expected calibration error as a number.

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> prob = np.array([[0.9, 0.1], [0.2, 0.8], [0.6, 0.4]])
    >>> ax = pdr.plot.reliability(prob, np.array([True, True, False]))
    >>> ax.get_xlabel()
    'confidence'
    """
    axes = given_or_new(ax, (4.2, 4.2))
    diagram = probability_calibration.reliability_diagram(prob, correct, n_bins)
    lowest = 1.0 / prob.shape[1]  # the smallest possible maximum of K probabilities
    axes.plot([lowest, 1.0], [lowest, 1.0], color=FAINT, linewidth=1.0)
    axes.vlines(diagram.confidence, diagram.confidence, diagram.accuracy, color=BLUE, linewidth=1.0)
    axes.scatter(diagram.confidence, diagram.accuracy, s=12 + 300 * diagram.share, color=BLUE, edgecolors=INK, zorder=3)
    axes.set(xlabel="confidence", ylabel="accuracy", xlim=(lowest, 1.02), ylim=(min(lowest, 0.2), 1.02))
    error = f"calibration error {diagram.expected_calibration_error:.3f}"
    axes.annotate(error, (0.04, 0.94), xycoords="axes fraction", va="top", color=INK)
    add_grid(axes)
    return axes


def nees(nees: FloatArray, ax: Axes | None = None, dof: int = 2) -> Axes:
    """Draw the histogram of normalised squared errors (NEES) with the chi-square density of a consistent filter.

    The mean NEES of a consistent filter is `dof`. A larger mean shows that the covariances are too small.

    Parameters
    ----------
    nees : ndarray of shape (N,)
        Values from `pdr_filter.evaluate.nees`. Non-finite values are ignored.
    ax : matplotlib Axes, optional
        Axes to draw into. By default a new figure is created.
    dof : int, default 2
        Degrees of freedom, that is, the number of dimensions of the error.

    Returns
    -------
    matplotlib Axes
        `ax`, or the axes of the new figure (`ax.figure`).

    Raises
    ------
    ValueError
        If no value of `nees` is finite.

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> ax = pdr.plot.nees(np.random.default_rng(0).chisquare(2, 200))
    >>> ax.get_xlabel()
    'normalised squared error'
    """
    from scipy.stats import chi2  # imported here: it takes as long to load as all else that a picture of a track needs

    axes = given_or_new(ax)
    finite = nees[np.isfinite(nees)]
    if not len(finite):
        raise ValueError(
            "nees must contain a finite value, got none; the covariances may be singular: check that they are not zero"
        )
    far = max(float(chi2.ppf(0.999, dof)), float(np.quantile(finite, 0.98)))
    edges = np.linspace(0.0, far, int(np.clip(np.sqrt(len(finite)) * 1.5, 8, _MOST_BINS)) + 1)
    share = np.histogram(finite, edges)[0] / (len(finite) * np.diff(edges))
    at = np.linspace(far / 400, far, 400)
    axes.stairs(share, edges, fill=True, color=BLUE, alpha=0.4, label=f"{len(finite)} errors, mean {finite.mean():.2f}")
    axes.plot(at, chi2.pdf(at, dof), color=INK, linewidth=1.4, label=f"chi-square, mean {dof}")
    bound = float(chi2.ppf(0.95, dof))
    inside = 100 * float((finite <= bound).mean())
    axes.axvline(
        bound, color=FAINT, linewidth=1.0, linestyle=(0, (4, 2)), label=f"95 % ellipse: contains {inside:.0f} %"
    )
    beyond = int((finite > far).sum())
    axes.set(
        xlabel="normalised squared error" + (f" ({beyond} beyond)" if beyond else ""), ylabel="density", xlim=(0, far)
    )
    axes.legend(frameon=False)
    return axes
