"""Files of transition probabilities and of the exponents of evidence: what a filter needs besides a classifier.

`filter.imm.transition_probabilities` has the matrix of the default filter. `offline.training.transition_training`
estimates another one from recordings, and `recipes.with_transitions` gives it to a filter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdr_filter.classifiers.model_files import Arrays, ArtefactFormat, file_pair
from pdr_filter.values import CONTEXTS, FloatArray, check_array, check_name_of_context, check_transition_prob, read_only

FORMAT = ArtefactFormat("transitions", 1, "write the file again with pdr-filter train")


@dataclass(frozen=True, slots=True, eq=False)
class Transitions:
    """What a `PedestrianModel` needs besides a classifier and where it is from: `recipes.with_transitions` takes it.

    Parameters
    ----------
    transition_prob : (C, C)
        Between `contexts` from one step to the next; rows from, sum to one.
    evidence_exponent, prior_exponent : float
        Of the evidence of a window, as in `PedestrianModel`.
    counts : (C, C)
        Of `offline.training.context_sequences.count_transitions`, what the matrix was estimated from; zeros if there
        was nothing.
    card : dict
        What people should know: whether matrix and exponents are estimated or the default and why, data, log losses,
        date, versions. Anything that JSON holds.
    contexts : tuple of str
        Names of the contexts, C.
    """

    transition_prob: FloatArray
    evidence_exponent: float
    prior_exponent: float
    counts: FloatArray
    card: dict[str, Any] = field(default_factory=dict[str, Any])
    contexts: tuple[str, ...] = CONTEXTS

    def __post_init__(self) -> None:
        for name in ("transition_prob", "counts"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        for name in self.contexts:
            check_name_of_context(name)
        if len(set(self.contexts)) < len(self.contexts):
            raise ValueError(f"contexts must have different names, got {self.contexts}")
        check_transition_prob(self.transition_prob, len(self.contexts))
        check_array("counts", self.counts, "0 or more", self.transition_prob.shape)
        for name in ("evidence_exponent", "prior_exponent"):
            check_array(name, getattr(self, name), "0 or more")

    def save(self, folder: str | Path) -> Path:
        """Write `transitions.json` into the folder and return its path."""
        content = {
            "contexts": list(self.contexts),
            "transition_prob": self.transition_prob,
            "evidence_exponent": self.evidence_exponent,
            "prior_exponent": self.prior_exponent,
            "counts": self.counts,
            "card": self.card,
        }
        path, _ = file_pair(Path(folder) / "transitions")
        FORMAT.write(path, content)
        return path


def load_transitions(path: str | Path) -> Transitions:
    """What `Transitions.save` wrote. ValueError that names the file, what is wrong with it and the remedy."""
    return FORMAT.read(path, _assemble)


def _assemble(content: Mapping[str, Any], _: Arrays) -> Transitions:
    """Return the transitions; KeyError, TypeError or ValueError if anything is missing or does not fit."""
    return Transitions(
        transition_prob=content["transition_prob"],
        evidence_exponent=float(content["evidence_exponent"]),
        prior_exponent=float(content["prior_exponent"]),
        counts=content["counts"],
        card=dict(content["card"]),
        contexts=tuple(content["contexts"]),
    )
