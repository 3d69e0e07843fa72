"""Where the Jacobians of ranges stand in the factors of their keyframes: the same at every linearization."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from factors.increments import npt_int
from factors.so3 import Array


@dataclass(frozen=True)
class RangeLayout:
    """Groups of ranges that share a keyframe, with the keys of each and the rows of their blocks.

    Attributes
    ----------
    groups : rows of each group; keys : pose, velocity, bias, up to two of Markov errors, anchors as first heard.
    markov : how many of these are Markov errors.
    anchor_row : (K,) row of each range in the blocks of all anchors, one below the other, `anchor_rows` in all.
    """

    groups: list[slice]
    keys: list[list[int]]
    markov: list[tuple[int, ...]]
    anchor_row: npt_int
    anchor_rows: int

    @classmethod
    def of(
        cls,
        groups: list[slice],
        state_keys: tuple[npt_int, ...],
        markov_keys: tuple[npt_int, npt_int],
        anchor_key: npt_int,
    ) -> RangeLayout:
        """That of ranges (K,) with these keys."""
        keys, markov, row, rows = [], [], np.empty(len(anchor_key), np.int64), 0
        for group in groups:
            at, count = group.start, group.stop - group.start
            there = tuple(column for column in (0, 1) if markov_keys[column][at] >= 0)
            heard: dict[int, int] = {}
            for k, key in enumerate(anchor_key[group].tolist()):
                row[at + k] = rows + heard.setdefault(key, len(heard)) * count + k
            rows += len(heard) * count
            own = [int(each[at]) for each in state_keys] + [int(markov_keys[column][at]) for column in there]
            keys.append([*own, *heard])
            markov.append(there)
        return cls(groups, keys, markov, row, rows)

    def blocks(
        self, states: tuple[Array, ...], markov: Array, slot: npt_int, slots: int, anchor: Array, offset: Array | None
    ) -> Iterator[list[Array]]:
        """Jacobians of each group, in the order of its keys, then by the offset where there is one.

        Parameters
        ----------
        states : (K, size) by pose, velocity and bias; markov : (K, 2) by the two Markov values in entry `slot` (K,) of
            `slots`; anchor : (K, 4); offset : (K, 1) or None.
        """
        row = np.arange(len(anchor))
        by_markov = np.zeros((2, len(anchor), slots))
        if slots:
            by_markov[0, row, slot], by_markov[1, row, slot] = markov.T
        by_anchor = np.zeros((self.anchor_rows, anchor.shape[1]))
        by_anchor[self.anchor_row] = anchor
        first = 0
        for group, keys, there in zip(self.groups, self.keys, self.markov, strict=True):
            found = [each[group] for each in states]
            found += [by_markov[column, group] for column in there]
            count = group.stop - group.start
            for _ in range(len(keys) - len(found)):
                found.append(by_anchor[first : first + count])
                first += count
            if offset is not None:
                found.append(offset[group])
            yield found
