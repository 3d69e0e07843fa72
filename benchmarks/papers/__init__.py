"""Reproductions of published experiments, one script per paper: their figures beside ours and the graph's."""
