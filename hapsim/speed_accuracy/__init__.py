"""Comparison of cost and accuracy of a simulated second, over objects, methods, rates and precisions."""
