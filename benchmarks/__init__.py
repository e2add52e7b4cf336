"""What `cabinpose bench` runs: measurements of this package, beside peers. Part of a checkout, not of an installed package."""

from collections.abc import Callable

Say = Callable[[str], None]  # called with what is being measured
