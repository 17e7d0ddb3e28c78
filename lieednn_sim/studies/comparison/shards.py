"""Division of a comparison's cases among machines that share only a disk."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from lieednn_sim.errors import InputError
from lieednn_sim.studies.comparison.rows import Case
from lieednn_sim.validation import as_count


@dataclass(frozen=True)
class Shard:
    """A part of the cases; a case's shard depends on the name of the case alone.

    Attributes:
        number: its number, starting at 1.
        of: the number of shards.

    Raises:
        InputError: there is no such shard.
    """

    number: int
    of: int

    def __post_init__(self) -> None:
        if as_count("the number of a shard", self.number) > as_count("the number of shards", self.of):
            raise InputError(f"there is no shard {self}: shards are numbered from 1 to {self.of}")

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read ``K/N``; `InputError` if the text is not of that form."""
        number, _, of = text.partition("/")
        if not (text.isascii() and number.isdecimal() and of.isdecimal() and len(text) < 20):
            raise InputError(f"a shard must look like 3/10, the third of ten, got {text!r}")
        return cls(int(number), int(of))

    @classmethod
    def holding(cls, case: Case, of: int) -> Shard:
        """The shard, out of ``of``, that holds a case."""
        digest = hashlib.sha256(str(case).encode()).digest()
        return cls(int.from_bytes(digest[:8], "big") % of + 1, of)

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"
