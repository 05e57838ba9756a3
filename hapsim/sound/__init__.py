"""What a running scene's sound becomes: loudspeakers (`play.py`, `resample.py`) and files (`wav.py`)."""
