"""A node of ROS 2 that finds people in a depth camera's frames.

source /opt/ros/jazzy/setup.bash    # rclpy, message_filters, sensor_msgs, visualization_msgs
python cabinpose_node.py --ros-args -p model:=in_car -r depth:=/camera/depth/image_raw -r ir:=/camera/ir/image_raw

Reads `depth` (sensor_msgs/Image, 16UC1 in mm or 32FC1 in m, as REP 118 has it), `ir` (mono16, 16UC1 or mono8) where the model
wants amplitudes, and `camera_info` of the depth. Publishes `~/people` (visualization_msgs/MarkerArray, metres in the frame of the
depth image, which is the optical one: x right, y down, z forward, in ROS as here) and `~/image` (rgb8, with the skeletons).
"""

from __future__ import annotations

import sys

import message_filters
import numpy as np
import rclpy
from geometry_msgs.msg import Point
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from visualization_msgs.msg import Marker, MarkerArray

import cabinpose
from cabinpose.core import CabinposeError, skeleton_of
from cabinpose.store import PERSON_COLOUR, FoundPeople

PIXELS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4", "mono8": "u1"}
PRESENT = 0.5  # probability from which on a joint is shown
LIFETIME_NS = 500_000_000  # of a marker, when no frame follows
JOINT_M, LIMB_M = 0.04, 0.015


def pixels(image: Image) -> np.ndarray:
    """(H, W) of an image's bytes, rows as long as it says, in the byte order that it says; ValueError for other encodings."""
    if image.encoding not in PIXELS:
        raise ValueError(f"an image of {image.encoding}, and {', '.join(PIXELS)} are known")
    kind = np.dtype(PIXELS[image.encoding]).newbyteorder(">" if image.is_bigendian else "<")
    rows = np.frombuffer(bytes(image.data), np.uint8).reshape(image.height, image.step)
    return rows[:, : image.width * kind.itemsize].copy().view(kind).astype(kind.newbyteorder("="))


def metres(image: Image) -> np.ndarray:
    """(H, W) float32 m, NaN where nothing was measured."""
    depth = pixels(image).astype(np.float32) * (0.001 if image.encoding == "16UC1" else 1.0)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.nan).astype(np.float32)


class CabinposeNode(Node):
    """One model on one camera."""

    def __init__(self) -> None:
        super().__init__("cabinpose")
        self.model = cabinpose.load_model(self.declare_parameter("model", "in_car").value)
        self.model.drive_side = self.declare_parameter("drive_side", "").value
        if self.model.drive_side not in ("", "left", "right"):
            raise ValueError(f"drive_side is left or right, not {self.model.drive_side!r}")
        self.camera: CameraInfo | None = None
        self.people = self.create_publisher(MarkerArray, "~/people", 1)
        self.pictures = self.create_publisher(Image, "~/image", 1)
        self.create_subscription(CameraInfo, "camera_info", self.keep_camera, qos_profile_sensor_data)
        names = ["depth", *(["ir"] if "amplitude" in self.model.images else [])]
        inputs = [message_filters.Subscriber(self, Image, name, qos_profile=qos_profile_sensor_data) for name in names]
        self.frames = message_filters.ApproximateTimeSynchronizer(inputs, queue_size=5, slop=0.01)
        self.frames.registerCallback(self.look)

    def keep_camera(self, info: CameraInfo) -> None:
        """Remember the intrinsics, which come with each frame."""
        self.camera = info

    def look(self, depth: Image, ir: Image | None = None) -> None:
        """Find people in a frame, and publish them."""
        if self.camera is None:
            self.get_logger().warning("no camera_info yet", once=True)
            return
        if len(self.camera.d) not in (0, 5):
            self.get_logger().error(f"distortion of {len(self.camera.d)} coefficients: rectify the images", once=True)
            return
        try:
            metric = metres(depth)
            k, dist = np.reshape(self.camera.k, (3, 3)), np.array(self.camera.d) if len(self.camera.d) else np.zeros(5)
            found = self.model(metric, k, None if ir is None else pixels(ir), camera_dist=dist)
        except (CabinposeError, ValueError) as error:
            self.get_logger().error(str(error), throttle_duration_sec=5.0)
            return
        self.people.publish(self.markers(found, depth))
        if self.pictures.get_subscription_count():
            picture = found.draw(metric)
            height, width = picture.shape[:2]
            message = Image(header=depth.header, height=height, width=width, encoding="rgb8", step=3 * width)
            message.data = picture.tobytes()
            self.pictures.publish(message)

    def markers(self, found: FoundPeople, depth: Image) -> MarkerArray:
        """Joints and limbs of each person, as two markers in a namespace of its name; of who is not there they are deleted."""
        array = MarkerArray()
        seen = np.isfinite(found.joints_3d).all(axis=-1) & (found.presence >= PRESENT)
        for person, name in enumerate(found.persons):
            places = [Point(x=x, y=y, z=z) for x, y, z in found.joints_3d[person].astype(float).tolist()]
            limbs = [end for limb in skeleton_of(found).limbs if seen[person, list(limb)].all() for end in limb]
            for number, (kind, which, size) in enumerate(
                ((Marker.SPHERE_LIST, np.flatnonzero(seen[person]), JOINT_M), (Marker.LINE_LIST, limbs, LIMB_M))
            ):
                marker = Marker(header=depth.header, ns=name, id=number, type=kind)
                marker.action = Marker.ADD if len(which) else Marker.DELETE
                marker.points = [places[joint] for joint in which]
                marker.scale.x = marker.scale.y = marker.scale.z = size
                marker.color.r, marker.color.g, marker.color.b = (c / 255 for c in PERSON_COLOUR[person % len(PERSON_COLOUR)])
                marker.color.a = marker.pose.orientation.w = 1.0
                marker.lifetime.nanosec = LIFETIME_NS
                array.markers.append(marker)
        return array


def main() -> None:
    """Run until Ctrl-C."""
    rclpy.init(args=sys.argv)
    rclpy.spin(CabinposeNode())


if __name__ == "__main__":
    main()
