"""Running a scene: open the line, describe, arm, loop, disarm; and every way out of it tells the device to release."""

from hapsim.running.excitation import Excitation
from hapsim.running.run import run
from hapsim.running.session import Session
from hapsim.running.starting import start

__all__ = ["Excitation", "Session", "run", "start"]
