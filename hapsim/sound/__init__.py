"""Output of a scene's sound to loudspeakers (`play.py`, `resample.py`) and files (`wav.py`)."""
