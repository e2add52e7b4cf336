"""The studio in the browser: configure scenes, look at data, label, compare, run detectors live."""
