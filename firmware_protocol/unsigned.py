"""Unsigned numbers for the indices of hot loops: a signed index may count from the end, and compiled code looks whether
it does at every access. Signed and unsigned must not be mixed: numba makes a floating-point number of the two.
"""

from __future__ import annotations

import numpy as np

ONE = np.uint64(1)
