"""The types of module that a program can have, in the order in which they act. A new one is a file and a name here."""

from __future__ import annotations

from hapsim.cordis.build_context import PartType
from hapsim.cordis.modules import linear_links, membrane, nonlinear_links, pick_ups, points, string, table_links

PART_TYPES: tuple[PartType, ...] = (
    *points.TYPES,
    *string.TYPES,
    membrane.MEMBRANE,
    *linear_links.TYPES,
    *table_links.TYPES,
    *nonlinear_links.TYPES,
    pick_ups.PICK_UP,  # hears the forces of all links
)
