"""Labels that people set, and corrections that come back from other tools: what the studio and `import` do, without a page."""
