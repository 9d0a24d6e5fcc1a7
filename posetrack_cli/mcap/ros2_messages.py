"""Written ROS 2 messages: published definitions, and plain CDR encoding.

Definitions are those of ROS 2 Humble; later versions differ in constants only. As with rosbag2, each schema
includes its nested types, so reading a file does not require ROS.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from posetrack_cli.mcap.ros_messages import Field, parse_fields
from posetrack_cli.mcap.sink import SchemaText

CDR = "cdr"
_RULE = "=" * 80
_HEAD = b"\0\1\0\0"  # plain CDR, little-endian, no options
_CODES = {
    **{"bool": "?", "uint8": "B", "int32": "i", "uint32": "I"},
    **{"float32": "f", "float64": "d"},
}

# By type, ``package/Name``; written types have unique names across packages.
DEFINITIONS: Mapping[str, str] = {
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "nav_msgs/Odometry": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist",
    "sensor_msgs/CameraInfo": "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\n"
    "float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\n"
    "sensor_msgs/RegionOfInterest roi",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\n"
    "float64[] velocity\nfloat64[] effort",
    "sensor_msgs/PointCloud2": "std_msgs/Header header\nuint32 height\nuint32 width\n"
    "sensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\n"
    "bool is_dense",
    "sensor_msgs/PointField": "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\n"
    "uint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\n"
    "uint32 count",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\n"
    "bool do_rectify",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "std_msgs/Float64": "float64 data",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "visualization_msgs/Marker": "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\n"
    "int32 LINE_STRIP=4\nint32 LINE_LIST=5\nint32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\n"
    "int32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\nint32 TRIANGLE_LIST=11\nint32 ADD=0\nint32 MODIFY=0\n"
    "int32 DELETE=2\nint32 DELETEALL=3\nstd_msgs/Header header\nstring ns\nint32 id\nint32 type\n"
    "int32 action\ngeometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
    "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
    "std_msgs/ColorRGBA[] colors\nstring texture_resource\nsensor_msgs/CompressedImage texture\n"
    "visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n"
    "visualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials",
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
}

_NAMES = {kind.rpartition("/")[2]: kind for kind in DEFINITIONS}
_LAYOUTS = {name: parse_fields(DEFINITIONS[kind]) for name, kind in _NAMES.items()}


def ros2_schema(kind: str) -> SchemaText:
    """Return the schema of a type, ``package/Name``, including its nested types."""
    package, name = kind.split("/")
    parts = dict.fromkeys(_parts(name))
    below = "".join(f"\n{_RULE}\nMSG: {_NAMES[part]}\n{DEFINITIONS[_NAMES[part]]}" for part in parts)
    return SchemaText(f"{package}/msg/{name}", "ros2msg", (DEFINITIONS[kind] + below).encode())


def ros2_encoder(kind: str) -> Callable[[Mapping[str, Any]], bytes]:
    """Return the plain CDR encoder of a type.

    It takes values by field name, nested for parts; missing ones are zero or empty. It raises KeyError for
    an unknown field, ValueError for a wrong array length and struct.error for a number out of range.
    """
    name = kind.rpartition("/")[2]
    _LAYOUTS[name]  # fail early for an unknown type

    def encode(values: Mapping[str, Any]) -> bytes:
        writer = _CdrWriter()
        writer.message(name, values)
        return _HEAD + writer.data

    return encode


def _parts(name: str) -> Iterator[str]:
    """Yield the nested types of a type, each before its own parts, with repetitions."""
    for field in _LAYOUTS[name]:
        if field.kind in _LAYOUTS:
            yield field.kind
            yield from _parts(field.kind)


class _CdrWriter:
    """Appends values; numbers are aligned to their size, counted from the end of the header."""

    def __init__(self) -> None:
        self.data = bytearray()

    def message(self, name: str, values: Mapping[str, Any]) -> None:
        fields = _LAYOUTS[name]
        if not values.keys() <= {field.name for field in fields}:
            raise KeyError(f"{name} has no {', '.join(values.keys() - {field.name for field in fields})}")
        for field in fields:
            self._field(field, values.get(field.name))

    def _field(self, field: Field, value: Any) -> None:
        if not field.array:
            self._value(field.kind, value)
        elif field.array == "[]":
            entries = () if value is None else value
            self._numbers("I", (len(entries),))
            self._entries(field.kind, entries)
        else:
            count = int(field.array[1:-1])
            entries = (0,) * count if value is None else value
            if len(entries) != count:
                raise ValueError(f"{field.name} of {len(entries)} entries, not {count}")
            self._entries(field.kind, entries)

    def _entries(self, kind: str, values: Any) -> None:
        if kind == "uint8":
            self.data += bytes(values)
        elif kind in _CODES:
            self._numbers(_CODES[kind], values)
        else:
            for value in values:
                self._value(kind, value)

    def _value(self, kind: str, value: Any) -> None:
        if kind in _CODES:
            self._numbers(_CODES[kind], (value or 0,))
        elif kind == "string":
            text = (value or "").encode("utf-8", "backslashreplace") + b"\0"
            self._numbers("I", (len(text),))
            self.data += text
        else:
            self.message(kind, value or {})

    def _numbers(self, code: str, values: Sequence[Any]) -> None:
        if len(values):
            self.data += bytes(-len(self.data) % struct.calcsize(code))
            self.data += struct.pack(f"<{len(values)}{code}", *values)
