"""The types of module that a scene is made of, one a file: their numbers, and what a tick does with them."""
