"""From a recording to a dataset: its sources in one time and one space. See docs/alignment.md."""
