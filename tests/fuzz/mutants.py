"""Byte-level strategies: what may have become of a file on its way.

A mutant is a list of edits of a sound file. Edits prefer the offsets that show readers what
follows, which each seed names: header fields, records, tables. Sizes and counts get the values at
which integers overflow, offsets get those of other offsets.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from hypothesis import strategies as st

Kind = Literal["integer", "float", "bytes", "cut", "insert", "remove", "repeat", "flip"]

INTEGERS: Final = (
    *(0, 1, 2, 7, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFF_FFFF, 0x8000_0000),
    *(0xFFFF_FFFF, 2**32, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1, 1_000_000, 10**9, 10**13),
)
FLOATS: Final = (
    *(0.0, -0.0, 1e300, -1e300, 1e-300, float("nan"), float("inf"), float("-inf"), 1e10, -1.0),
)
TEXTS: Final = (
    *(b"\xff\xfe\xfd", b"\x00", b"\x1b[31m", b"<script>", b"\n\r", b"%n%s", b"\x80" * 9, b"'\";"),
    *(b"9e999", b"-", b",", b"\n", b"nan", b"1e400", b" ", b"\t;", b"{}", b"0" * 40, b"7" * 400),
)


@dataclass(frozen=True)
class Edit:
    """One change of a file."""

    kind: Kind
    at: int
    width: int
    value: int

    def apply(self, content: bytearray) -> None:
        """Do it, in place."""
        at = self.at % max(len(content), 1)
        if self.kind == "integer":
            mask = (1 << (8 * self.width)) - 1
            put(content, at, (self.value & mask).to_bytes(self.width, "little"))
        elif self.kind == "float":
            put(content, at, struct.pack("<d", FLOATS[self.value % len(FLOATS)]))
        elif self.kind == "bytes":
            put(content, at, TEXTS[self.value % len(TEXTS)])
        elif self.kind == "flip":
            if content:
                content[at] ^= 1 << self.value % 8
        elif self.kind == "cut":
            del content[at:]
        elif self.kind == "insert":
            content[at:at] = TEXTS[self.value % len(TEXTS)] * self.width
        elif self.kind == "remove":
            del content[at : at + self.width]
        else:
            content[at:at] = content[at : at + self.width]


def put(content: bytearray, at: int, value: bytes) -> None:
    """Overwrite bytes; what lies beyond the end is lost."""
    end = min(at + len(value), len(content))
    content[at:end] = value[: end - at]


@dataclass(frozen=True)
class Seed:
    """A sound file and its tender offsets."""

    content: bytes
    suffix: str
    tender: Sequence[tuple[int, int]] = field(default=())


def edits(seed: Seed) -> st.SearchStrategy[Edit]:
    """A change of a seed: mostly in a tender part, some anywhere."""
    parts = list(seed.tender) or [(0, len(seed.content))]
    inside = st.sampled_from(parts).flatmap(
        lambda part: st.integers(part[0], max(part[1] - 1, part[0]))
    )
    offsets = st.one_of(inside, inside, inside, st.integers(0, max(len(seed.content) - 1, 0)))
    kinds: list[Kind] = ["integer"] * 5 + ["float", "float", "bytes", "bytes", "flip", "flip"]
    rare: list[Kind] = ["cut", "insert", "remove", "repeat"]
    values = st.one_of(
        st.sampled_from(INTEGERS), st.integers(0, 2**64 - 1), st.integers(0, len(seed.content))
    )
    return st.builds(
        Edit, st.sampled_from(kinds * 2 + rare), offsets, st.sampled_from((1, 2, 4, 8)), values
    )


def mutants(seed: Seed) -> st.SearchStrategy[bytes]:
    """Files that a seed may have become."""

    def made(changes: list[Edit]) -> bytes:
        content = bytearray(seed.content)
        for change in changes:
            change.apply(content)
        return bytes(content)

    return st.lists(edits(seed), min_size=1, max_size=5).map(made)
