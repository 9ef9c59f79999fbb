# SPDX-License-Identifier: BSD-3-Clause
"""A column of words of which there are few: kept as numbers until somebody reads it or writes it down."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import DTypeLike, NDArray


@dataclass(frozen=True, eq=False)
class Words:
    """N words, the one in row k being words[codes[k]], no code being negative; to numpy an array of text, (N,)."""

    codes: NDArray[np.signedinteger[Any]]
    words: tuple[str, ...]

    @staticmethod
    def room(rows: int, words: Sequence[str]) -> Words:
        """Room for so many of these words, not yet written."""
        return Words(np.empty(rows, dtype=np.min_scalar_type(-len(words))), tuple(words))

    @staticmethod
    def joined(parts: Sequence[Words]) -> Words:
        """One column after the other, all of the same words."""
        return Words(np.concatenate([part.codes for part in parts]), parts[0].words)

    @property
    def dtype(self) -> np.dtype[Any]:
        """That of the text."""
        return self._texts.dtype

    @property
    def shape(self) -> tuple[int]:
        """(N,)."""
        return (len(self.codes),)

    @property
    def size(self) -> int:
        """N."""
        return len(self.codes)

    @property
    def ndim(self) -> int:
        """1."""
        return 1

    def astype(self, dtype: DTypeLike) -> NDArray[Any]:
        """The text as an array of another kind."""
        return np.asarray(self).astype(dtype)

    def __len__(self) -> int:
        return len(self.codes)

    def __repr__(self) -> str:
        return f"Words({np.array2string(np.asarray(self), separator=', ', threshold=10)})"

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("words are kept as numbers; text of them is always a copy")
        return np.asarray(self._texts[self.codes], dtype=dtype)

    @overload
    def __getitem__(self, here: int | np.integer[Any]) -> str: ...
    @overload
    def __getitem__(self, here: slice | NDArray[Any]) -> Words: ...
    def __getitem__(self, here: Any) -> str | Words:
        found = self.codes[here]
        return self.words[found] if np.ndim(found) == 0 else Words(found, self.words)

    def __eq__(self, other: object) -> Any:
        """Row by row: where it says this word, or what another column says."""
        return self.codes == self._code(other) if isinstance(other, str) else np.asarray(self) == np.asarray(other)

    def __ne__(self, other: object) -> Any:
        """Row by row: where it says something else."""
        return ~(self == other)

    __hash__ = None  # pyright: ignore[reportAssignmentType] - like an array, it has none

    def __iter__(self) -> Iterator[str]:
        return (self.words[code] for code in self.codes.tolist())

    def tolist(self) -> list[str]:
        """Plain text."""
        return list(self)

    def _code(self, word: str) -> int:
        return self.words.index(word) if word in self.words else len(self.words)

    @property
    def _texts(self) -> NDArray[np.str_]:
        return np.array(self.words, dtype=np.str_)


def spelled(columns: Mapping[str, NDArray[Any] | Words]) -> dict[str, NDArray[Any]]:
    """The same columns, their words as text."""
    return {name: np.asarray(column) for name, column in columns.items()}
