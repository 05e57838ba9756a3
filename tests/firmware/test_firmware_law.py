"""The firmware's integers of a line, in the pieces that a small processor multiplies, against those of lines.py."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable

from firmware_protocol.lines import SHIFTS, bound_in_force_counts, shifted_product

WORDS = (-(2**31), -(2**31) + 1, -65537, -65536, -65535, -1, 0, 1, 32768, 65535, 65536, 2**31 - 1)


def test_a_product_is_the_same_at_the_ends_of_every_range_and_between(law: Callable[[list[str]], list[str]]) -> None:
    chance = random.Random(72)
    factors = (-32768, -32767, -1, 0, 1, 2, 32767, 32768, 65535)
    cases = list(itertools.product(factors, WORDS, SHIFTS))
    for _ in range(5000):
        way = chance.randrange(-(2**31), 2**31) >> chance.randrange(31)
        cases.append((chance.randrange(-32768, 65536), way, chance.choice(SHIFTS)))
    found = law([f"shifted_product {factor} {way} {shift}" for factor, way, shift in cases])
    assert [int(word) for word in found] == [shifted_product(*case) for case in cases]


def test_a_bound_is_the_same_for_every_limit(law: Callable[[list[str]], list[str]]) -> None:
    chance = random.Random(72)
    bounds = (-32768, -32767, -32766, -1, 0, 1, 2, 16384, 32766, 32767)
    limits = (1, 32766, 32767, 32768, 65535 * 32767 - 1, 65535 * 32767, 10**7, 10**9, 2**31 - 2, 2**31 - 1)
    cases = list(itertools.product(bounds, limits))
    cases += [(chance.randrange(-32768, 32768), chance.randrange(1, 2**31)) for _ in range(5000)]
    found = law([f"bound {bound} {limit}" for bound, limit in cases])
    assert [int(word) for word in found] == [bound_in_force_counts(*case) for case in cases]
