"""From what an instrument recorded of a button or a knob to the curve of a link, and a scene with it."""
