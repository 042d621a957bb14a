"""Send the point cloud of a hand from a RealSense camera to airtact, as JSON over a websocket.

The script requires ``pyrealsense2`` (which requires the system's libusb 1.0), NumPy and
``websockets``::

    python realsense.py --side left --to ws://127.0.0.1:8765

Point clouds are in the frame of the depth camera, in metres. The origin is the left lens; x points
to the right and y down in the image, and z away from the camera. All points closer than
``--farthest`` are assumed to belong to the hand, so nothing else may be in front of the camera.
``fit_hand`` also requires approximate landmarks from another tracker. Times are those of the
camera's clock.

Without a camera, ``--depths`` plays depth images through a *software device* of the same library.
"""

import argparse
import importlib
import json
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any


def main() -> None:
    """Read the camera and send frames until it stops."""
    options = _options()
    frames = _clouds_in(_played(options) if options.depths else _seen(), options)
    if options.to is None:
        for frame in frames:
            print(json.dumps(frame), flush=True)
        return
    from websockets.sync.client import connect

    with connect(options.to, compression=None) as receiver:
        for frame in frames:
            receiver.send(json.dumps(frame))


def _clouds_in(depths: Iterator[Any], options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield frames with the points of a hand, or lost frames if there are too few points."""
    import numpy as np

    cloud = _library().pointcloud()
    for sequence, depth in enumerate(depths):
        vertices = np.asanyarray(cloud.calculate(depth).get_vertices())
        points = vertices.view(np.float32).reshape(-1, 3)
        points = points[(points[:, 2] > options.nearest) & (points[:, 2] < options.farthest)]
        # Every n-th point, rounded to 0.01 mm, which is far below the camera's noise.
        points = points[:: max(1, -(-len(points) // options.points))].astype(np.float64).round(5)
        yield {
            "time": 1e-3 * depth.get_timestamp(),
            "side": options.side,
            "sequence": sequence,
            "cloud": points.tolist() if len(points) >= 200 else None,
        }


def _library() -> ModuleType:
    """Load pyrealsense2, which has no type stubs."""
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        raise SystemExit(
            f"pyrealsense2 does not load ({error}); run pip install 'airtact[realsense]' and "
            "install libusb (libusb-1.0-0)."
        ) from None


def _seen() -> Iterator[Any]:
    """Read depth frames from the connected camera."""
    rs = _library()
    pipeline = rs.pipeline()
    config = rs.config()
    config.enable_stream(rs.stream.depth, 640, 480, rs.format.z16, 30)
    try:
        pipeline.start(config)
    except RuntimeError as error:
        raise SystemExit(
            f"no RealSense camera can be read: {error}; connect one, or use --depths."
        ) from None
    # The camera is in use until the pipeline is stopped.
    try:
        while True:
            yield pipeline.wait_for_frames().get_depth_frame()
    finally:
        pipeline.stop()


def _played(options: argparse.Namespace) -> Iterator[Any]:
    """Play depth images, .npy files (H, W) in metres, through a software device."""
    import numpy as np

    rs = _library()
    files = sorted(file for file in options.depths.glob("*.npy") if file.is_file())
    if not files:
        raise SystemExit(
            f"{options.depths} contains no .npy files; use a folder with depth images."
        )
    rows, columns = _picture(files[0]).shape
    # A pinhole camera without distortion.
    lens = rs.intrinsics()
    lens.width = columns
    lens.height = rows
    lens.ppx = columns / 2
    lens.ppy = rows / 2
    lens.fx = lens.fy = options.focal
    lens.model = rs.distortion.none
    lens.coeffs = [0.0] * 5
    stream = rs.video_stream()
    stream.type = rs.stream.depth
    stream.index = 0
    stream.uid = 0
    stream.width = columns
    stream.height = rows
    stream.fps = 30
    stream.bpp = 2
    stream.fmt = rs.format.z16
    stream.intrinsics = lens
    unit = 1e-4  # depth of one level [m]
    device = rs.software_device()
    sensor = device.add_sensor("Depth")
    profile = rs.video_stream_profile(sensor.add_video_stream(stream))
    sensor.add_read_only_option(rs.option.depth_units, unit)
    queue = rs.frame_queue(4)
    sensor.open(profile)
    sensor.start(queue)
    for number, file in enumerate(files):
        metres = _picture(file, (rows, columns))
        # Level 0 means no depth.
        levels = np.where(np.isfinite(metres), np.round(metres / unit), 0.0)
        frame = rs.software_video_frame()
        frame.pixels = np.ascontiguousarray(levels.astype(np.uint16))
        frame.stride = 2 * columns
        frame.bpp = 2
        frame.depth_units = unit
        frame.profile = profile.as_video_stream_profile()
        frame.domain = rs.timestamp_domain.hardware_clock
        frame.timestamp = 1e3 * number / 30
        frame.frame_number = number
        sensor.on_video_frame(frame)
        yield queue.wait_for_frame(5000).as_depth_frame()
    sensor.stop()
    sensor.close()


def _picture(file: Path, shape: tuple[int, int] | None = None) -> Any:
    """Read a depth image with the ``shape`` of the first; exit if it is invalid."""
    import numpy as np

    try:
        metres = np.load(file, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError, SyntaxError) as error:
        raise SystemExit(
            f"{file.name} is not a depth image: {error}; save depth images with numpy.save."
        ) from None
    if metres.ndim != 2 or not 1 <= metres.size <= 2**24 or metres.dtype.kind not in "fiu":
        raise SystemExit(
            f"{file.name} has shape {metres.shape} and type {metres.dtype}; a depth image must "
            "have shape (H, W), in metres, with at most 2^24 pixels."
        )
    if shape is not None and metres.shape != shape:
        raise SystemExit(
            f"{file.name} has shape {metres.shape}, but the first image has shape {shape}; all "
            "images must have the same shape."
        )
    return metres


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Send the point cloud of a hand from a RealSense camera to airtact."
    )
    parser.add_argument(
        "--to",
        help="address of the receiver, such as ws://127.0.0.1:8765; by default, frames are printed",
    )
    parser.add_argument("--side", choices=("left", "right"), required=True, help="side of the hand")
    parser.add_argument(
        "--nearest",
        type=float,
        default=0.1,
        help="closer points are ignored [m] (default: 0.1)",
    )
    parser.add_argument(
        "--farthest", type=float, default=0.6, help="farther points are ignored [m] (default: 0.6)"
    )
    parser.add_argument(
        "--points", type=int, default=4000, help="largest number of points (default: 4000)"
    )
    parser.add_argument(
        "--depths", type=Path, help="folder of depth images to play instead of a camera"
    )
    parser.add_argument(
        "--focal", type=float, default=600.0, help="their focal length in pixels (default: 600)"
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
