"""Windows of a recording."""

from __future__ import annotations

from dataclasses import dataclass

from pdr_filter.values.arrays import FloatArray, pickled


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Windows:
    """Context and carrying-mode probabilities of all windows of a recording."""

    time_s: FloatArray  # (W,) window ends
    context_prob: FloatArray  # (W, C)
    contexts: tuple[str, ...]
    carrying_prob: FloatArray  # (W, D) after each window, of all windows so far
    carrying_modes: tuple[str, ...]
    unknown_share: FloatArray  # (W,) how unlike the classifier's training windows, 0 to 1; `context_prob` has it in
    stairs_unknown_share: FloatArray  # (W,) how unlike stairs in training window and place of the phone are, 0 to 1
    irregular_prob: FloatArray  # (W,) that the motion moves nobody: the phone taken out, turned, put away
    climb_rate_mps: FloatArray  # (W,) from the barometer, up positive; NaN without
    model: tuple[str, ...]  # (W,) name of the model that classified the context
    standing_contexts: tuple[str, ...] = ("stationary",)  # contexts without steps

    __reduce__ = pickled

    @property
    def standing_prob(self) -> FloatArray:
        """Probability that nobody steps in each window, (W,)."""
        return self.context_prob[:, self.standing_index].sum(axis=1)

    @property
    def standing_index(self) -> list[int]:
        """Indices of the contexts without steps."""
        return [i for i, name in enumerate(self.contexts) if name in self.standing_contexts]

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"Windows({len(self)} windows)"
