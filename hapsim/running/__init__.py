"""Running a scene: open the port, describe, arm, loop, disarm. Every way out asks the device to release its force.

`__all__` lists the public names.
"""

from hapsim.loop.counts import Progress
from hapsim.recording.recorder import Samples, Stream
from hapsim.recording.trace import Report, Statistics, Trace
from hapsim.running.live_parameters import Parameter
from hapsim.running.run import run
from hapsim.running.session import Session, sessions
from hapsim.running.session_options import Excitation, PeriodicExcitation
from hapsim.running.session_view import Event, State
from hapsim.running.start import start

__all__ = [
    "Event",
    "Excitation",
    "Parameter",
    "PeriodicExcitation",
    "Progress",
    "Report",
    "Samples",
    "Session",
    "State",
    "Statistics",
    "Stream",
    "Trace",
    "run",
    "sessions",
    "start",
]
