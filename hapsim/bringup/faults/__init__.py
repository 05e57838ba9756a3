"""Faults on the wire, on purpose: between a host and a device, by a script, the same every time.

`script.py` reads which faults happen when; `injector.py` passes bytes on and does them. Two carriers bring
it bytes and tell the time: `relay.py` between a pseudo-terminal and a port, `in_memory.py` around a transport.
"""

from hapsim.bringup.faults.injector import Injector, Passed
from hapsim.bringup.faults.kinds import KINDS
from hapsim.bringup.faults.script import Script, load_script, parse_script

__all__ = ["KINDS", "Injector", "Passed", "Script", "load_script", "parse_script"]
