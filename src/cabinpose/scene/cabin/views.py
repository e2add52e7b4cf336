"""Camera places in the cabins built here: three that look at seats, and those where cameras of products sit.

Places of products: `mirror` is the housing of the inner mirror (TICaM's Azure Kinect, Magna's patents), `roof_console` the
headlining between the visors, `cluster` the cover of the steering column (BMW X5's manual), `a_pillar` the driver's pillar,
`display` beside the centre display (Mazda MX-30's manual). The makers say where, in words; the places to the centimetre are
assumed.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from cabinpose.scene.cabin.cockpit import dash_measures, steering_wheel
from cabinpose.scene.cabin.layout import Layout
from cabinpose.scene.cabin.model import ViewAnchor
from cabinpose.scene.cabin.shell import mirror_place

SeatView = Literal["driver", "front_row", "rear"]
ProductView = Literal["mirror", "roof_console", "cluster", "a_pillar", "display"]
View = Literal[SeatView, ProductView]
VIEWS_OF_ALL: tuple[str, ...] = get_args(SeatView)  # the views that every cabin has which is built here
PRODUCT_VIEWS: tuple[str, ...] = get_args(ProductView)  # and those of products, where there is a dashboard
_EYES_UP = 0.64  # m above the H-point: a driver's eyes, roughly
_FREE = 0.045  # m from a lens to the part that its camera sits in


def built_views(layout: Layout) -> dict[str, ViewAnchor]:
    """The views of a cabin, left-hand drive: `VIEWS_OF_ALL`, and those of products where it has a dashboard."""
    front, rear = layout.h_front, layout.h_rear
    if layout.facing:
        roof_z = float(layout.roof_line(0.5 * (front[0] + rear[0]))) - 0.08
        middle = 0.5 * (front[0] + rear[0])
        return {
            "driver": ViewAnchor(np.array([middle - 0.12, front[1] * 0.75, roof_z - 0.02]), front + (0.10, 0.0, 0.30)),
            "front_row": ViewAnchor(np.array([middle - 0.25, 0.0, roof_z]), np.array([front[0] + 0.1, 0.0, front[2] + 0.28])),
            "rear": ViewAnchor(np.array([middle + 0.25, 0.0, roof_z]), np.array([rear[0] - 0.1, 0.0, rear[2] + 0.28])),
        }
    shape, face_x, top_z, _ = dash_measures(layout)
    x = layout.header_x + 0.11
    under_glass = layout.header_z - 0.11 / max(layout.screen_slope, 0.3)
    driver_eye = np.array([x, front[1] * 0.62, under_glass - 0.075])
    front_x = min(face_x - shape.stack - 0.085, front[0] + 0.62)  # clear of a screen that stands on the dashboard
    front_eye = np.array([front_x, 0.0, min(top_z + 0.17, layout.header_z - 0.20)])  # under the mirror
    rear_x = rear[0] + 0.66
    rear_eye = np.array([rear_x, 0.0, float(layout.roof_line(rear_x)) - 0.075])
    seats = {
        "driver": ViewAnchor(driver_eye, front + (-0.10, -0.03, 0.33)),
        "front_row": ViewAnchor(front_eye, np.array([front[0] - 0.12, 0.0, front[2] + 0.36])),
        "rear": ViewAnchor(rear_eye, np.array([rear[0] - 0.10, 0.0, rear[2] + 0.30])),
    }
    return seats | _of_products(layout)


def _of_products(layout: Layout) -> dict[str, ViewAnchor]:
    front = layout.h_front
    shape, face_x, top_z, _ = dash_measures(layout)
    face = front + (-0.10, 0.0, _EYES_UP - 0.06)
    mirror_x, mirror_z = mirror_place(layout)
    console_x = layout.header_x - 0.14
    console_eye = np.array([console_x, 0.0, float(layout.roof_line(console_x)) - _FREE])
    wheel = steering_wheel(layout).vehicle_from_wheel
    column_eye = wheel[:3, 3] - 0.035 * wheel[:3, 2] + 0.107 * wheel[:3, 0]
    pillar_z = layout.belt_z + 0.20
    pillar_x = float(layout.a_pillar_x(pillar_z)) - _FREE
    pillar_y = float(layout.half_width(pillar_x, pillar_z)) - 0.08
    mirror_eye = np.array([mirror_x - _FREE - 0.02, 0.0, mirror_z - 0.02])
    display_eye = np.array([face_x - shape.stack - 0.10, 0.17, top_z + 0.03])
    return {
        "mirror": ViewAnchor(mirror_eye, np.array([front[0] - 0.30, 0.0, front[2] + 0.25])),
        "roof_console": ViewAnchor(console_eye, np.array([front[0] - 0.16, 0.0, front[2] + 0.33])),
        "cluster": ViewAnchor(column_eye, face),
        "a_pillar": ViewAnchor(np.array([pillar_x, pillar_y, pillar_z]), face - (0.0, 0.0, 0.15)),
        "display": ViewAnchor(display_eye, face - (0.0, 0.0, 0.15)),
    }
