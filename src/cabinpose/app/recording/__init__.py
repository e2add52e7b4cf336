"""What a recording looks like: a page of time lines, rates, gaps and sample frames."""
