"""Many masses at once: SIMD lanes, and stencils that go through a structure in them."""
