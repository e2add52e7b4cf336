"""A thing: a thermos flask that lies on a seat."""

from cabinpose.scene.things import Kind, Piece, of_design, turned_body


def _pieces(variant: int) -> tuple[Piece, ...]:
    """Standing on z = 0; a design is drawn for each frame."""
    radius, high = of_design(0.032, 0.042, variant, 1), of_design(0.22, 0.30, variant, 2)
    body = turned_body([(0.0, 0.0), (radius, 0.0), (radius, 0.8 * high), (0.8 * radius, high), (0.0, high)])
    return (Piece("body", body, "hard_plastic"),)


THERMOS = Kind("bottle", _pieces, on_seat="lies")
