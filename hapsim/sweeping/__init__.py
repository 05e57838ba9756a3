"""A thousand scenes: each point of a sweep predicted, measured on the mock in virtual time, or worked out otherwise."""
