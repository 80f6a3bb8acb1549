"""Files of transition probabilities and evidence exponents, which a filter needs besides a classifier.

`filter.imm.transition_probabilities` has the matrix of the default filter. `offline.training.transition_training`
estimates another one from recordings, and `recipes.with_transitions` gives it to a filter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from pdr_filter.classifiers.model_files import Arrays, ArtefactFormat, file_pair
from pdr_filter.values import CONTEXTS, FloatArray, check_array, check_name_of_context, check_transition_prob, read_only

FORMAT = ArtefactFormat("transitions", 1, "write the file again with pdr-filter train")


@dataclass(frozen=True, slots=True, eq=False)
class Transitions:
    """Transition probabilities of contexts and evidence exponents, with their origin, for `recipes.with_transitions`.

    Parameters
    ----------
    transition_prob : array_like, shape (C, C)
        Probability of a transition from context i to context j of `contexts` between two steps. Rows sum to one.
    evidence_exponent, prior_exponent : float
        Exponents of the evidence of a window, as in `PedestrianModel`.
    counts : array_like, shape (C, C)
        Numbers of transitions from which the matrix was estimated
        (`offline.training.context_sequences.count_transitions`). Zeros if there were no data.
    card : dict
        Information for users: origin of matrix and exponents, data, log losses, date, versions. Any JSON values.
    contexts : tuple of str
        Names of the C contexts.

    Raises
    ------
    ValueError
        If the matrix has wrong shapes or rows that do not sum to one, or an exponent is negative.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.classifiers.transition_files import Transitions
    >>> stay = 0.9 * np.eye(6) + 0.1 / 6
    >>> transitions = Transitions(stay, evidence_exponent=0.3, prior_exponent=1.0, counts=np.zeros((6, 6)))
    >>> round(float(transitions.transition_prob[0, 0]), 3)
    0.917
    """

    transition_prob: FloatArray
    evidence_exponent: float
    prior_exponent: float
    counts: FloatArray
    card: dict[str, Any] = field(default_factory=dict[str, Any])
    contexts: tuple[str, ...] = CONTEXTS

    def __post_init__(self) -> None:
        for name in ("transition_prob", "counts"):
            object.__setattr__(self, name, read_only(getattr(self, name), name))
        for name in self.contexts:
            check_name_of_context(name)
        if len(set(self.contexts)) < len(self.contexts):
            raise ValueError(f"contexts must have different names, got {self.contexts}")
        check_transition_prob(self.transition_prob, len(self.contexts))
        check_array("counts", self.counts, "0 or more", self.transition_prob.shape)
        for name in ("evidence_exponent", "prior_exponent"):
            check_array(name, getattr(self, name), "0 or more")

    def save(self, folder: str | Path) -> Path:
        """Write `transitions.json`.

        Parameters
        ----------
        folder : str or Path
            Folder of the file.

        Returns
        -------
        Path
            The written file.
        """
        path, _ = file_pair(Path(folder) / "transitions")
        FORMAT.write(path, {f.name: getattr(self, f.name) for f in fields(self)})
        return path


def load_transitions(path: str | Path) -> Transitions:
    """Read the file that `Transitions.save` wrote.

    Parameters
    ----------
    path : str or Path
        The file `transitions.json`.

    Returns
    -------
    Transitions
        Transition probabilities and exponents.

    Raises
    ------
    ValueError
        If the file is missing, damaged, or of another kind or version. The message names file, problem and remedy.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from pdr_filter.classifiers.transition_files import Transitions, load_transitions
    >>> stay = 0.9 * np.eye(6) + 0.1 / 6
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Transitions(stay, 0.3, 1.0, np.zeros((6, 6))).save(folder)
    ...     load_transitions(path).evidence_exponent
    0.3
    """
    return FORMAT.read(path, _assemble)


def _assemble(content: Mapping[str, Any], _: Arrays) -> Transitions:
    """Return the transitions. `FORMAT.read` turns errors of missing or wrong parts into ValueError."""
    return Transitions(
        transition_prob=content["transition_prob"],
        evidence_exponent=float(content["evidence_exponent"]),
        prior_exponent=float(content["prior_exponent"]),
        counts=content["counts"],
        card=dict(content["card"]),
        contexts=tuple(content["contexts"]),
    )
