"""What a simulated second costs, and how far from the continuous object it is: objects, methods, rates, precisions."""
