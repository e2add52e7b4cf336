"""Part affinity fields: the thesis' network, peaks, and people assembled along the fields."""
