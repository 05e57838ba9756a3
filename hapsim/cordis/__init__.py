"""The CORDIS modules and the compiled tick (Cadoz, Luciani and Florens; Florens et al., §6, Figure 5)."""
