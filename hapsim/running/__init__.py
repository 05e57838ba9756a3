"""Running a scene: open the port, describe, arm, loop, disarm. Every way out asks the device to release its force.

Public is what `__all__` names.
"""

from hapsim.progress import Progress
from hapsim.recording.trace import Report, Statistics, Trace
from hapsim.running.options import Excitation, PeriodicExcitation
from hapsim.running.run import run, start
from hapsim.running.session import Session, sessions

__all__ = [
    "Excitation",
    "PeriodicExcitation",
    "Progress",
    "Report",
    "Session",
    "Statistics",
    "Trace",
    "run",
    "sessions",
    "start",
]
