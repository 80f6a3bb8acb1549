"""Windows of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pdr_filter.values.arrays import FloatArray, pickled


def pandas_module(method: str) -> Any:
    """Return the module pandas; ImportError that names the extra to install if it is missing."""
    try:
        import pandas  # pyright: ignore  (optional)
    except ImportError:
        raise ImportError(f'{method} needs pandas: pip install "pdr_filter[parquet]"') from None
    return pandas


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

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame with one row per window; needs the extra `parquet`.

        Columns: `time_s`, `context_prob_NAME`, `carrying_prob_NAME`, `unknown_share`, `stairs_unknown_share`,
        `irregular_prob`, `climb_rate_mps` and `model`.
        """
        columns = {
            "time_s": self.time_s,
            **{f"context_prob_{name}": self.context_prob[:, i] for i, name in enumerate(self.contexts)},
            **{f"carrying_prob_{name}": self.carrying_prob[:, i] for i, name in enumerate(self.carrying_modes)},
            **{name: getattr(self, name) for name in ("unknown_share", "stairs_unknown_share")},
            **{name: getattr(self, name) for name in ("irregular_prob", "climb_rate_mps")},
            "model": list(self.model),
        }
        return pandas_module("Windows.to_pandas").DataFrame(columns)

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
