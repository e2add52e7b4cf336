"""ToF cameras, one module a vendor: each gives `core.recorded.ToFFrame`."""
