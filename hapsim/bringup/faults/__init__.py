"""Fault injection on the wire: between a host and a device, by a script, the same every time.

`script.py` reads a script; `wire_faults.py` and `device_faults.py` have the kinds, on what `fault.py` defines;
`injector.py` applies them to bytes. Two carriers bring it bytes and the time: `relay.py` between a pseudo-terminal and
a port, `in_memory.py` around a transport. `witness.py` reports what reached the device.
"""

from hapsim.bringup.faults.injector import Injector, Passed
from hapsim.bringup.faults.script import KINDS, Script, load_script, parse_script

__all__ = ["KINDS", "Injector", "Passed", "Script", "load_script", "parse_script"]
