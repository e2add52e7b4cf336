"""The page on detectors: numbers, curves and worst frames of one evaluation, as one HTML file."""
