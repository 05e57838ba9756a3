"""The two checks of the protocol, compiled: CRC-16/DNP and CRC-32C, table-driven, reflected (a UART sends the least
significant bit first, so bursts on the line are bursts in the check).

Why these two: Koopman's tables give polynomial 0x3D65 distance 6 up to 135 bits of data and CRC-32C distance 6 up to
655 bytes; every frame stays within.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import jit_inlined


def _table(reflected_polynomial: int) -> NDArray[np.uint32]:
    table = np.zeros(256, np.uint32)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ (reflected_polynomial if crc & 1 else 0)
        table[byte] = crc
    return table


_DNP = _table(0xA6BC)  # 0x3D65, its bits reversed
_CASTAGNOLI = _table(0x82F63B78)  # 0x1EDC6F41, its bits reversed


@jit_inlined
def crc16_dnp(data, start, stop, seed):
    """CRC-16/DNP of data[start:stop] from start value `seed` (0: the catalogued one)."""
    crc = np.uint32(seed)
    for i in range(start, stop):
        crc = (crc >> np.uint32(8)) ^ _DNP[(crc ^ np.uint32(data[i])) & np.uint32(0xFF)]
    return crc ^ np.uint32(0xFFFF)


@jit_inlined
def crc32_c(data, start, stop, seed):
    """CRC-32C of data[start:stop] from start value `seed` (0xFFFFFFFF: the catalogued one)."""
    crc = np.uint32(seed)
    for i in range(start, stop):
        crc = (crc >> np.uint32(8)) ^ _CASTAGNOLI[(crc ^ np.uint32(data[i])) & np.uint32(0xFF)]
    return crc ^ np.uint32(0xFFFFFFFF)
