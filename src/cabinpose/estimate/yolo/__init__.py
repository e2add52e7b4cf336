"""Single-shot grid regression: cells of a grid answer with boxes, whose classes are the joints (Redmon et al. 2016)."""
