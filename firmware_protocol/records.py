"""Records: what compiled code and Python both read and write by name, in one piece of memory.

A record is a numpy scalar of a structured type, `record.ticks` on either side. Compiled code gets one pointer, whatever
it holds; records hold records, and arrays of a fixed length.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def new_record(dtype: np.dtype[np.void]) -> Any:
    """A record of zeros. It keeps its own memory, which stays where it is."""
    return np.zeros(1, dtype).view(np.recarray)[0]
