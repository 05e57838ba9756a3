"""The guards between scene and device, one a file: what ends a run, or changes a force, before it reaches a hand."""
