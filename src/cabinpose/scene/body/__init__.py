"""Parametric people: shape, skeleton with anatomical joints, clothing and part labels."""

from cabinpose.scene.body.model import BodyModel, Person, PosedBody
from cabinpose.scene.body.outfit import Outfit
from cabinpose.scene.body.phenotype import Phenotype
from cabinpose.scene.body.rig import DOF_INDEX, DOFS, SEGMENTS, Dof
from cabinpose.scene.body.subjects import SUBJECTS, Subject

__all__ = [
    "DOFS", "DOF_INDEX", "SEGMENTS", "SUBJECTS", "BodyModel", "Dof", "Outfit", "Person", "Phenotype", "PosedBody", "Subject",
]  # fmt: skip
