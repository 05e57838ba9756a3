"""Running a scene: open the port, describe, arm, loop, disarm; every way out tells the device to release.

Public is what `__all__` names: a run, and what it tells.
"""

from hapsim.progress import Progress
from hapsim.recording.trace import Report, Statistics, Trace
from hapsim.running.excitation import Excitation, PeriodicExcitation
from hapsim.running.run import run
from hapsim.running.session import Session, sessions
from hapsim.running.starting import start

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
