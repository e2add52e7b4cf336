"""Contact between bodies, and between bodies and the cabin: what yields, by how much, and what collides."""

from cabinpose.scene.contact.field import BAND_M, OUTSIDE, Contact, ContactField, ContactScene, PlacedField
from cabinpose.scene.contact.pairs import BOTH_YIELD_M, FLESH_M, PAIRS, SOLIDS, Pair
from cabinpose.scene.contact.solids import PosedSolids, SolidContact, SolidTopology, person_contact, self_contact, solid_topology
from cabinpose.scene.contact.triangles import first_crossings, sampled_surface

__all__ = [
    "BAND_M",
    "BOTH_YIELD_M",
    "FLESH_M",
    "OUTSIDE",
    "PAIRS",
    "SOLIDS",
    "Contact",
    "ContactField",
    "ContactScene",
    "Pair",
    "PlacedField",
    "PosedSolids",
    "SolidContact",
    "SolidTopology",
    "first_crossings",
    "person_contact",
    "sampled_surface",
    "self_contact",
    "solid_topology",
]
