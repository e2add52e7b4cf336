"""Seven cabins by name. Values are typical of their class (SAE J1100 sheets of production cars, rounded)."""

from __future__ import annotations

from types import MappingProxyType

from cabinpose.scene.cabin.dimensions import CabinDimensions

_ALL = (
    CabinDimensions(
        name="city_car", h30_mm=295, l53_mm=770, w20_mm=330, a40_deg=22, a27_deg=13, h61_mm=985, w3_mm=1290, l50_mm=740,
        h30_2_mm=325, w20_2_mm=290, a40_2_deg=23, h61_2_mm=940, w3_2_mm=1285, rear_places=2, w9_mm=365, a18_deg=27,
        l11_mm=370, h17_mm=680, clutch=True, h25_mm=430, a121_1_deg=55, a121_2_deg=28, a122_deg=14, header_mm=430, tail_mm=360,
        roof_drop_mm=35, b_pillar_mm=250, tunnel_mm=40, seat_style="compact", dash_style="simple", console_style="none",
        door_style="plain",
    ),
    CabinDimensions(
        name="hatchback", h30_mm=275, l53_mm=820, w20_mm=355, a40_deg=24, a27_deg=14, h61_mm=980, w3_mm=1410, l50_mm=805,
        h30_2_mm=305, w20_2_mm=345, a40_2_deg=25, h61_2_mm=955, w3_2_mm=1390, w9_mm=368, a18_deg=25, l11_mm=400, h17_mm=665,
        clutch=True, h25_mm=450, a121_1_deg=60, a121_2_deg=42, a122_deg=18, tail_mm=430, roof_drop_mm=55, b_pillar_mm=230,
        tunnel_mm=70, seat_style="comfort", dash_style="wave", console_style="low", door_style="pocket", centre_headrest=False,
    ),
    CabinDimensions(
        name="sedan", h30_mm=255, l53_mm=850, w20_mm=370, a40_deg=25, a27_deg=14.5, h61_mm=980, w3_mm=1450, l50_mm=870,
        h30_2_mm=285, w20_2_mm=365, a40_2_deg=27, h61_2_mm=955, w3_2_mm=1430, w9_mm=375, a18_deg=24, l11_mm=415, h17_mm=650,
        h25_mm=455, a121_1_deg=62, a121_2_deg=67, a122_deg=20, tail_mm=400, roof_drop_mm=80, b_pillar_mm=240, tunnel_mm=120,
        seat_style="comfort", dash_style="tier", console_style="tunnel", door_style="sweep", leather=True,
    ),
    CabinDimensions(
        name="coupe", h30_mm=180, l53_mm=900, w20_mm=370, a40_deg=26, a27_deg=17, h61_mm=950, w3_mm=1390, l50_mm=800,
        h30_2_mm=235, w20_2_mm=310, a40_2_deg=25, h61_2_mm=905, w3_2_mm=1330, rear_places=2, w9_mm=360, a18_deg=21,
        l11_mm=440, h17_mm=610, clutch=True, h25_mm=480, a121_1_deg=64, a121_2_deg=73, a122_deg=24, header_mm=430, tail_mm=330,
        roof_drop_mm=95, b_pillar_mm=420, tunnel_mm=170, seat_style="sport", rear_style="plus2", dash_style="driver",
        console_style="high", door_style="sport", leather=True,
    ),
    CabinDimensions(
        name="suv", h30_mm=325, l53_mm=825, w20_mm=385, a40_deg=23, a27_deg=13, h61_mm=1015, w3_mm=1490, l50_mm=850,
        h30_2_mm=345, w20_2_mm=375, a40_2_deg=25, h61_2_mm=1000, w3_2_mm=1480, w9_mm=380, a18_deg=27, l11_mm=390, h17_mm=705,
        h25_mm=470, a121_1_deg=57, a121_2_deg=38, a122_deg=15, header_mm=450, tail_mm=480, roof_drop_mm=30, b_pillar_mm=230,
        tunnel_mm=60, seat_style="comfort", dash_style="tier", console_style="high", door_style="sweep", leather=True,
    ),
    CabinDimensions(
        name="van", h30_mm=385, l53_mm=760, w20_mm=430, a40_deg=19, a27_deg=11, h61_mm=1060, w3_mm=1610, l50_mm=1000,
        h30_2_mm=375, w20_2_mm=480, a40_2_deg=21, h61_2_mm=1050, w3_2_mm=1640, w9_mm=400, a18_deg=38, l11_mm=345, h17_mm=735,
        h25_mm=430, a121_1_deg=46, a121_2_deg=10, a122_deg=8, header_mm=420, tail_mm=560, roof_drop_mm=10, b_pillar_mm=220,
        tunnel_mm=0, clutch=True, seat_style="captain", rear_style="captain", dash_style="upright", console_style="none",
        door_style="upright",
    ),
    CabinDimensions(
        name="shuttle", layout="facing", h30_mm=430, l53_mm=640, w20_mm=420, a40_deg=14, a27_deg=8, h61_mm=1160, w3_mm=1780,
        l23_fore_mm=0, l23_aft_mm=0, h58_mm=0, l50_mm=1420, h30_2_mm=430, w20_2_mm=520, a40_2_deg=14, a27_2_deg=8, h61_2_mm=1160,
        w3_2_mm=1780, h25_mm=330, a121_1_deg=14, a121_2_deg=14, a122_deg=5, header_mm=480, tail_mm=480, roof_drop_mm=20,
        b_pillar_mm=420, tunnel_mm=0, seat_style="bench", rear_style="bench", dash_style="none", console_style="none",
        door_style="wall",
    ),
)  # fmt: skip

PRESET_DIMENSIONS = MappingProxyType({d.name: d for d in _ALL})
PRESETS: tuple[str, ...] = tuple(PRESET_DIMENSIONS)
