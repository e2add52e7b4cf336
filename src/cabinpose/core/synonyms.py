"""What somebody meant by a name that does not exist here: one that is spelt alike, or what other tools call the same thing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from types import MappingProxyType

_ALIKE, _ELSEWHERE = 0.75, 0.85  # difflib's ratio, of names in the same mapping and in others: "height" is offered for no "high"
_MOST = 3
_UNITS = ("m", "mm", "cm", "px", "deg", "rad", "s", "us", "hz", "kg", "e")  # that keys end with


def by_word(rows: Mapping[str, str]) -> Mapping[str, tuple[str, ...]]:
    """Of "ours, ours": "theirs theirs ..." what each of their words stands for, in the order of the rows."""
    table: dict[str, tuple[str, ...]] = {}
    for ours, theirs in rows.items():
        for word in theirs.split():
            table[word] = (*table.get(word, ()), *ours.split(", "))
    return MappingProxyType(table)


# Keys of settings by the ends of their paths, and what Blender, COCO, OpenCV, Ultralytics, ROS and papers call them.
KEYS = by_word(
    {
        # scenes
        "scene.cars": "car vehicle vehicles cabin cabins car_model car_models vehicle_model",
        "scene.random_cars": "num_cars n_cars random_vehicles",
        "scene.right_hand_drive": "rhd drive_side steering_side lhd left_hand_drive",
        "scene.occupants, scene.occupancy": "driver passenger passengers front_passenger rear_left rear_right seat seats",
        "scene.occupants": "actors humans characters armature",
        "scene.motion, action": "actions activity behaviour behavior animation",
        "scene.belted": "seatbelt seat_belt seatbelts belts",
        "scene.child_seats": "child_seat isofix booster",
        "scene.children": "child kids children_share baby",
        "scene.objects, scene.in_hand": "props items phone bag luggage",
        "scene.sequence": "video clip trajectory animate temporal",
        # people
        "years": "age age_years years_old",
        "gender": "sex",
        "stature_cm": "stature height_cm height_m body_height tall",
        "mass_kg": "weight_kg mass body_mass",
        "outfit": "clothes clothing garment garments",
        "outfit.top": "shirt jacket",
        "outfit.bottom": "trousers pants",
        "outfit.headwear": "cap hat hijab beanie hood headscarf",
        "outfit.hair": "hairstyle",
        "people.subjects, people.own": "person persons human subject subject_id ids",
        "people.random.count": "num_people n_people num_persons people_count n_subjects",
        # cameras
        "camera.fov_deg": "fov hfov vfov field_of_view angle_x camera_angle_x angle fovx fov_x hfov_deg h_fov horizontal_fov",
        "camera.vfov": "fovy fov_y vfov_deg v_fov vertical_fov angle_y camera_angle_y",
        "camera.fx": "lens focal focal_length focal_length_px f",
        "sensor.camera, lens": "intrinsics camera_matrix k camera_k camera_info camera_intrinsics mtx cameramatrix intrinsic",
        "camera.dist, lens.dist": "distortion dist_coeffs distcoeffs d k1 k2 distortion_coefficients coeffs",
        "camera.width, width": "resolution image_size imgsz image_width res resolution_x img_size size",
        "camera.height, height": "image_height resolution_y",
        "camera.cx": "ppx principal_point c_x u0",
        "camera.cy": "ppy c_y v0",
        "position_m, eye": "position pos location eye translation tvec xyz camera_position origin t",
        "look_at_m, target": "look_at lookat target forward view_direction",
        "vehicle_from_camera": "extrinsics extrinsic matrix_world transform camera_pose pose matrix rvec rotation rotation_euler "
        "quaternion orientation t_camera",
        "camera.views": "view pov viewpoint viewpoints camera_views cameras poses",
        "roll_deg": "roll",
        "camera.sensor": "camera_model camera_name device_model",
        "sensor.fps, frame_rate_hz, rate_hz, sequence.rate_hz": "framerate frame_rate rate hz fps frequency_hz",
        "integration_s, integration_us": "exposure exposure_time integration_time integration_time_us exposure_us shutter "
        "shutter_speed exposure_s",
        "range_m": "clip_start clip_end near far max_depth min_depth depth_range depth_max max_range min_range range",
        "frequencies_hz, modulation_hz": "modulation_frequency modulation frequency frequencies",
        "camera.jitter_m, camera.jitter_deg": "camera_jitter camera_noise perturbation",
        # what is drawn and written
        "noise": "depth_noise noise_model noise_std gaussian",
        "images.variables": "rgb color colour nir ir infrared modalities passes render_passes",
        "images.renderer": "engine render_engine",
        "images.samples": "spp samples_per_pixel cycles_samples",
        "images.light": "lighting lights light_sources hdri world_light lamp sun_light",
        "output.skeletons": "keypoints skeleton joints keypoint_names kpt_shape landmarks joint_set",
        "output.frames_per_part": "chunk_size shard_size frames_per_file",
        "output.licence": "license",
        # training
        "learning_rate": "lr lr0 learningrate base_lr lr_init",
        "batch": "batch_size batchsize bs samples_per_gpu",
        "epochs": "max_epochs num_epochs n_epochs epoch iterations max_iter steps",
        "patience": "early_stopping early_stop",
        "optimiser": "optimizer",
        "schedule": "scheduler lr_scheduler cos_lr lr_schedule",
        "average": "ema ema_decay",
        "precision": "amp half fp16 bf16 mixed_precision dtype",
        "workers": "num_workers n_workers dataloader_workers",
        "augment": "augmentation augmentations aug transforms data_augmentation",
        "augment.flip": "flip fliplr flipud hflip horizontal_flip mirror",
        "augment.rotate_deg": "degrees rotate",
        "augment.shift": "translate",
        "augment.rescale": "scale",
        "method": "model arch architecture backbone network algorithm",
        "settings": "params hyperparameters hyp model_settings input_size widths",
        # cars
        "mesh": "file mesh_file path gltf glb obj filename filepath model_file geometry cad",
        "up_axis": "up axis_up z_up y_up",
        "front_axis": "forward front axis_forward heading",
        "unit": "units unit_scale length_unit",
        "h_point": "hpoint hip sgrp r_point position location seat_position",
        "steering_wheel": "wheel steering",
        "steering_wheel.centre": "center",
        "steering_wheel.diameter_mm": "diameter radius",
        "rules": "materials labels classes material",
        "eye": "camera",
        # recordings
        "sources": "cameras devices sensors inputs streams topics nodes",
        "take.subjects": "participants participant",
        "kind": "type driver device driver_name",
        "host": "ip ip_address address hostname server",
        "baud": "baudrate baud_rate",
        "path": "bag bagfile bag_file rosbag filename file uri",
        "source": "topic frame_id channel",
        "serial": "serial_number device_id serial_no",
    }
)

# Names of what is chosen, likewise.
NAMES = by_word(
    {
        "rgb": "color colour",
        "nir": "ir infrared",
        "city_car": "mini small_car compact_car smart",
        "sedan": "limousine saloon",
        "suv": "jeep 4x4 crossover offroad",
        "van": "minivan mpv bus minibus",
        "shuttle": "robotaxi people_mover",
        "drive": "driving steering steer",
        "phone_ear, phone_text": "phone telephone calling call texting mobile",
        "sleep": "sleeping asleep",
        "drink": "drinking",
        "read": "reading",
        "window": "look_out",
        "front_passenger": "passenger codriver co_driver passenger_front front_right",
        "rear_left, rear_center, rear_right": "rear back back_seat rear_passenger",
        "rear_center": "middle rear_middle back_middle",
        "infant": "infant_carrier baby_seat babyseat maxi_cosi",
        "toddler, booster": "toddler_seat child_seat childseat",
        "kinect_v1, azure_mkv": "kinect xbox structured_light openni",
        "pico_monstar_105": "monstar pmd picoflexx pico",
        "azure_mkv, azure-mkv": "azure k4a azure_kinect kinect_azure mkv",
        "rosbag2": "rosbag bag ros ros2 db3",
        "png-json": "png json images",
        "yolo": "ultralytics yolov5 yolov8 yolov11 yolo11 yolo_pose",
        "coco": "coco_json cocojson keypoints ms_coco",
        "unet, parts": "segmentation segment semantic u_net",
        "compact": "resnet mobilenet default heatmap",
        "paf": "openpose part_affinity",
        "lifting": "lift lifter 2d_to_3d",
        "mvn": "xsens awinda",
        "mt": "mti imu",
        "simulated": "simulation webcam fake dummy",
        "orbbec": "femto astra",
        "realsense": "intel_realsense librealsense pyrealsense2 d435 d435i d455 d405 l515",
        "oak": "oak_d oakd depthai luxonis",
        "v4l2": "v4l uvc video4linux linuxpy v4l2py",
    }
)

# What is no key of settings, by what is said to those who look for it there.
ELSEWHERE = MappingProxyType(
    {
        word: told
        for told, words in (
            ("frames are counted by a flag, such as --frames 100", "frames num_frames n_frames n count num_samples num_images"),
            ("the seed is a flag, such as --seed 7", "seed random_seed rng_seed"),
            ("the folder is a flag: --out FOLDER", "out output output_dir out_dir save_dir project name path"),
            ("threads are a flag, such as --workers 4", "workers num_workers threads jobs n_jobs"),
            ("`cabinpose train` takes --devices 1; all else runs on the processor", "device devices gpu gpus cuda"),
            (
                "training is set by the file of `cabinpose train --config`",
                "epochs batch batch_size lr lr0 learning_rate imgsz optimizer optimiser patience",
            ),
            (
                "`cabinpose export coco` writes boxes, masks and keypoints of a dataset",
                "bbox bboxes boxes segmentation masks annotations category_id categories iscrowd",
            ),
            (
                "answers are cut where they are judged: `cabinpose evaluate --presence 0.5`",
                "conf conf_thres confidence threshold iou nms",
            ),
            ("`cabinpose import rosbag2` reads ROS 2 bags", "topic bag rosbag frame_id camera_info"),
            ("splits are chosen with --splits FILE where a dataset is used", "val validation test split splits"),
            ("`cabinpose train --init FILE` begins with trained weights", "weights pretrained checkpoint ckpt"),
            (
                "people are made of numbers (gender, years, stature_cm, mass_kg), cars may be meshes: `cabinpose car init MESH`",
                "mesh fbx glb smpl betas",
            ),
        )
        for word in words.split()
    }
)


def alike(
    word: str, known: Iterable[str], synonyms: Mapping[str, tuple[str, ...]] = KEYS, *, within: str = ""
) -> tuple[str, ...]:
    """The names that a word may stand for, at most three, the likeliest first; none where nothing is near.

    Parameters
    ----------
    word
        What somebody wrote.
    known
        The names that exist: plain ones, or paths of keys, "scene.occupants.NAME.subject", of which the last key counts.
    synonyms
        By words of others the names, or ends of paths, that they stand for.
    within
        Path of the mapping in which the word was found; names of the same one come first.
    """
    names = tuple(dict.fromkeys(known))
    said = word.lower().replace("-", "_")
    last = {name: name.rpartition(".")[2].removesuffix("[]").lower().replace("-", "_") for name in names}
    meant = [name for end in synonyms.get(said, ()) for name in names if name == end or name.endswith(f".{end}")]
    beside = [name for name in names if name.rpartition(".")[0] == within]
    spelt = [
        *get_close_matches(said, [last[name] for name in beside], n=_MOST, cutoff=_ALIKE),
        *get_close_matches(said, dict.fromkeys(last.values()), n=_MOST, cutoff=_ELSEWHERE),
    ]
    for found in (
        [name for name in names if last[name] == said],
        meant,
        [name for name in names if last[name].rpartition("_")[::2] in ((said, unit) for unit in _UNITS)],
        [name for near in spelt for name in names if last[name] == near],
    ):
        if found:
            return tuple(sorted(dict.fromkeys(found), key=lambda name: name not in beside)[:_MOST])
    return ()
