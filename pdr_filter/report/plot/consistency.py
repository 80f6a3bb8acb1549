"""Whether probabilities and covariances are as large as the errors."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import chi2

from pdr_filter.classifiers import probability_calibration
from pdr_filter.report.palette import BLUE, FAINT, INK
from pdr_filter.report.plot.figures import given_or_new, lined
from pdr_filter.values import BoolArray, FloatArray

_MOST_BINS = 40


def reliability(prob: FloatArray, correct: BoolArray, ax: Axes | None = None, n_bins: int = 15) -> Axes:
    """Draw how often predictions of one confidence were right, dots as large as their share of all predictions.

    `prob` (N, K) are probabilities, and `correct` (N,) says whether the highest was right. Dots on the line are right
    as often as they say.
    """
    axes = given_or_new(ax, (4.2, 4.2))
    diagram = probability_calibration.reliability(prob, correct, n_bins)
    lowest = 1.0 / prob.shape[1]  # of the highest of K
    axes.plot([lowest, 1.0], [lowest, 1.0], color=FAINT, linewidth=1.0)
    axes.vlines(diagram.confidence, diagram.confidence, diagram.accuracy, color=BLUE, linewidth=1.0)
    axes.scatter(diagram.confidence, diagram.accuracy, s=12 + 300 * diagram.share, color=BLUE, edgecolors=INK, zorder=3)
    axes.set(xlabel="confidence", ylabel="share that is right", xlim=(lowest, 1.02), ylim=(min(lowest, 0.2), 1.02))
    error = f"mean distance {diagram.expected_calibration_error:.3f}"
    axes.annotate(error, (0.04, 0.94), xycoords="axes fraction", va="top", color=INK)
    lined(axes)
    return axes


def nees(nees: FloatArray, ax: Axes | None = None, dof: int = 2) -> Axes:
    """Draw normalised squared errors (N,) of `pdr_filter.evaluate.nees` beside the chi-square density that they have.

    If covariances are right, their mean is `dof`; it is more if they are too small.
    """
    axes = given_or_new(ax)
    finite = nees[np.isfinite(nees)]
    if not len(finite):
        raise ValueError("nees must have a finite value, got none; are the covariances zero?")
    far = max(float(chi2.ppf(0.999, dof)), float(np.quantile(finite, 0.98)))
    edges = np.linspace(0.0, far, int(np.clip(np.sqrt(len(finite)) * 1.5, 8, _MOST_BINS)) + 1)
    share = np.histogram(finite, edges)[0] / (len(finite) * np.diff(edges))
    at = np.linspace(far / 400, far, 400)
    axes.stairs(share, edges, fill=True, color=BLUE, alpha=0.4, label=f"{len(finite)} errors, mean {finite.mean():.2f}")
    axes.plot(at, chi2.pdf(at, dof), color=INK, linewidth=1.4, label=f"chi-square, mean {dof}")
    bound = float(chi2.ppf(0.95, dof))
    inside = 100 * float((finite <= bound).mean())
    axes.axvline(bound, color=FAINT, linewidth=1.0, linestyle=(0, (4, 2)), label=f"95 % ellipse: holds {inside:.0f} %")
    beyond = int((finite > far).sum())
    axes.set(
        xlabel="normalised squared error" + (f" ({beyond} beyond)" if beyond else ""), ylabel="density", xlim=(0, far)
    )
    axes.legend(frameon=False)
    return axes
