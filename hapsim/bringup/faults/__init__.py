"""Fault injection on the wire: between a host and a device, by a script, the same every time.

`kinds.py` has the kinds of faults, on what `fault.py` defines; `injector.py` reads a script and applies it to bytes.
Two carriers bring it bytes and the time: `relay.py` between a pseudo-terminal and a port, `in_memory.py` around a
transport. `witness.py` reports what reached the device.
"""

from hapsim.bringup.faults import kinds as _kinds  # noqa: F401  defines them
from hapsim.bringup.faults.fault import KINDS
from hapsim.bringup.faults.injector import Injector, Passed, Script, load_script, parse_script

__all__ = ["KINDS", "Injector", "Passed", "Script", "load_script", "parse_script"]
