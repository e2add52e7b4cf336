"""The 3D view of a tab, drawn only where something in it changed, turned by mouse and keys; and the bodies of a scene in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from nicegui import ui
from nicegui.elements.scene import Object3D
from numpy.typing import NDArray

# NiceGUI draws twenty times a second, also what nobody sees. Without a GPU that takes a whole core, and with it the time that
# pictures need. What is drawn again: another place of camera or object, another shape, colour or size of the view.
_ON_CHANGE = """() => {
  const view = getElement(%s), renderer = view.renderer, render = renderer.render.bind(renderer);
  const numbers = new WeakMap();
  const number = (thing) => thing && (numbers.get(thing) ?? numbers.set(thing, Math.random()).get(thing));
  let last = "";
  renderer.render = (scene, camera) => {
    const canvas = renderer.domElement;
    if (!canvas.clientWidth) return;
    camera.updateMatrixWorld();
    const eye = [...camera.matrixWorld.elements, ...camera.projectionMatrix.elements];
    const now = [canvas.width, canvas.height, ...eye.map((x) => Math.round(1e6 * x))]; // its controls turn it to and fro by 1e-16
    scene.traverseVisible(({ id, position, quaternion, scale, geometry, material }) => now.push(id, ...position, ...quaternion,
      ...scale, geometry?.id, number(geometry?.attributes?.position),
      material?.id, material?.version, material?.opacity, material?.color?.getHex()));
    const key = now.join();
    if (key === last) return;
    last = key;
    render(scene, camera);
  };
  const turned = Math.PI / 24, nearer = 1.1, up = view.camera.up.clone();
  view.$el.tabIndex = 0;
  view.$el.addEventListener("keydown", (event) => {
    const { camera, controls } = view, target = controls.target, arm = camera.position.clone().sub(target);
    const side = arm.clone().cross(up).normalize(), height = arm.angleTo(up);
    const turn = (by) => arm.applyAxisAngle(up, by);
    const tilt = (by) => arm.applyAxisAngle(side, Math.min(Math.max(by, 0.05 - (Math.PI - height)), height - 0.05));
    const move = (x, y) => target.addScaledVector(side, -x).addScaledVector(up, y);
    const moves = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }; // m
    const keys = {
      ArrowLeft: () => turn(-turned), ArrowRight: () => turn(turned), ArrowUp: () => tilt(turned), ArrowDown: () => tilt(-turned),
      "+": () => arm.divideScalar(nearer), "=": () => arm.divideScalar(nearer), "-": () => arm.multiplyScalar(nearer),
    };
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
    event.preventDefault(); event.stopPropagation();
    if (event.shiftKey && moves[event.key]) move(...moves[event.key]); else keys[event.key]();
    camera.position.copy(target).add(arm);
  });
}"""
VIEW_KEYS = (("arrows, + −", "in a 3D view: turn it, nearer and farther; with Shift the arrows move it"),)


class Marks(NamedTuple):
    """What is drawn beside bodies, places as (x, y, z) m.

    lines: colour and two ends · balls: colour, radius and place · measures: two ends, in front of all · words: with a place.
    """

    lines: Sequence[tuple[str, Sequence[float], Sequence[float]]] = ()
    balls: Sequence[tuple[str, float, Sequence[float]]] = ()
    measures: Sequence[tuple[Sequence[float], Sequence[float]]] = ()
    words: Sequence[tuple[str, Sequence[float]]] = ()


class SceneBodies(Object3D, component="scene_body.js"):
    """Cabin, people and things of a scene in a 3D view, with marks. What is new is fetched, and all of it shown at once."""

    def show(self, number: int, bodies: Mapping[str, Any], marks: Marks) -> None:
        """Show bodies by name, as `SceneRoom.bodies` has them. number: of the scene."""
        self.args = [number, bodies, marks._asdict()]
        self.run_method("show", *self.args)


def view_3d(**handlers: Callable[..., Any]) -> ui.scene:
    """A dark view without a floor that fills its place, turned by mouse and keys; handlers: `on_drag_end` of `ui.scene`, ..."""
    view = ui.scene(grid=False, background_color="#1b1e24", **handlers)  # type: ignore[arg-type]
    view.props("role=application aria-label='3D view: arrows turn it, plus and minus zoom'").classes("studio-view")
    view.on("init", js_handler=_ON_CHANGE % view.id)
    view.style("width: 100%; height: 100%")
    return view


def look_through(view: ui.scene, vehicle_from_camera: NDArray[np.float64]) -> None:
    """Put the eye at a camera's place, a little behind and above it; vehicle_from_camera: (4, 4)."""
    eye = vehicle_from_camera[:3, 3] - 0.4 * vehicle_from_camera[:3, 2] + np.array([0, 0, 0.2])
    target = vehicle_from_camera[:3, 3] + 1.2 * vehicle_from_camera[:3, 2]
    (x, y, z), (look_x, look_y, look_z) = eye.tolist(), target.tolist()
    view.move_camera(x, y, z, look_x, look_y, look_z, 0, 0, 1, duration=0)


class FramePoints(Object3D, component="points.js"):
    """A frame's cloud and its skeletons, in the view in whose block it is made; the browser takes as many as it can draw."""

    def show(self, url: str, skeletons: Sequence[dict[str, Any]], ahead: Sequence[str] = ()) -> None:
        """Show the cloud behind a URL of `clouds` ("": none) with `skeleton_lines`; ahead: URLs that may come next."""
        self.args = [url, list(skeletons), list(ahead)]
        self.run_method("show", *self.args)


def skeleton_lines(points: NDArray[np.floating], limbs: Sequence[Sequence[int]], colour: str) -> dict[str, Any]:
    """A person's joints (J, 3) m in the view's frame, NaN where there is none, as `FramePoints` draws them."""
    there = np.isfinite(points).all(axis=1)
    places = np.round(points, 4).tolist()
    lines = [[places[a], places[b]] for a, b in limbs if there[a] and there[b]]
    return {
        "colour": colour,
        "lines": lines,
        "joints": [place for place, is_there in zip(places, there, strict=True) if is_there],
    }
