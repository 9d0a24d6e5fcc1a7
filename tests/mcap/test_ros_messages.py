"""ROS messages by their published layout: bytes made by hand, and by another implementation of ROS 2."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli import limits
from posetrack_cli.mcap.ros_messages import (
    DEFINITIONS,
    LAYOUTS,
    Field,
    OtherLayoutError,
    check_definition,
    parse_fields,
    ros_decoder,
)

RULE = "=" * 80
# As `rosmsg show --raw` and `ros2 interface show` print them, shortened in their comments.
CAMERA_INFO_1 = f"""# This message defines meta information for a camera.
std_msgs/Header header    # Header timestamp should be acquisition time of image
uint32 height
uint32 width
string distortion_model
float64[] D
float64[9]  K # 3x3 row-major matrix
float64[9]  R # 3x3 row-major matrix
float64[12] P # 3x4 row-major matrix
uint32 binning_x
uint32 binning_y
RegionOfInterest roi
{RULE}
MSG: std_msgs/Header
uint32 seq
#Two-integer timestamp
time stamp
string frame_id
{RULE}
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
"""
TRANSFORMS_2 = f"""geometry_msgs/TransformStamped[] transforms
{RULE}
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
Transform transform
{RULE}
MSG: geometry_msgs/Transform
Vector3 translation
Quaternion rotation
{RULE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{RULE}
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
{RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE_2 = f"""std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
{RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
INFO_2 = (
    CAMERA_INFO_1.replace(" D\n", " d\n").replace(" K ", " k ").replace(" R ", " r ").replace(" P ", " p ")
)
INFO_2 = INFO_2.split(RULE)[0] + RULE + IMAGE_2.split(RULE, 1)[1] + RULE + CAMERA_INFO_1.split(RULE)[2]


def test_a_ros_1_image_as_the_wire_format_says() -> None:
    data = struct.pack("<III", 7, 5, 6) + b"\x03\0\0\0cam" + struct.pack("<II", 2, 3)
    data += b"\x05\0\0\0mono8" + b"\x00" + struct.pack("<I", 3) + b"\x06\0\0\0abcdef"
    image = ros_decoder("ros1", "Image")(data)
    assert (image.header.seq, image.header.stamp, image.header.frame_id) == (
        7,
        SimpleNamespace(sec=5, nanosec=6),
        "cam",
    )
    assert (image.height, image.width, image.encoding, image.is_bigendian) == (2, 3, "mono8", 0)
    assert (image.step, image.data) == (3, b"abcdef")


def test_cdr_aligns_numbers_to_their_size() -> None:
    """After "abc" and its zero (8 bytes with the length) nothing is skipped; after "a" two bytes are."""
    for frame_id, gap in (("abc", b""), ("a", b"\0\0")):
        data = b"\0\1\0\0" + struct.pack("<iI", -1, 2) + struct.pack("<I", len(frame_id) + 1)
        data += frame_id.encode() + b"\0" + gap + struct.pack("<II", 4, 5) + b"\1\0\0\0\0" + b"\0\0\0"
        k = [float(i) for i in range(9)]
        data += struct.pack("<I", 0)  # no distortion: nothing is aligned for none
        data += b"\0" * (-(len(data) - 4) % 8) + struct.pack("<9d9d12d", *k, *k, *range(12))
        info = ros_decoder("cdr", "CameraInfo")(data)
        assert (info.header.stamp.sec, info.header.stamp.nanosec) == (-1, 2)
        assert (info.height, info.width, info.distortion_model, info.d) == (4, 5, "", ())
        assert (info.k, info.p) == (tuple(k), tuple(map(float, range(12))))


text = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
number = st.floats(allow_nan=False)
header = st.fixed_dictionaries(
    {
        "stamp": st.fixed_dictionaries(
            {"sec": st.integers(0, 2**31 - 1), "nanosec": st.integers(0, 2**32 - 1)}
        ),
        "frame_id": text,
    }
)
vector = st.fixed_dictionaries(dict.fromkeys("xyz", number))
MESSAGES = {
    "Image": st.fixed_dictionaries(
        {
            "header": header,
            "height": st.integers(0, 2**32 - 1),
            "width": st.integers(0, 2**32 - 1),
            "encoding": text,
            "is_bigendian": st.integers(0, 255),
            "step": st.integers(0, 2**32 - 1),
            "data": st.binary(max_size=30),
        }
    ),
    "TFMessage": st.fixed_dictionaries(
        {
            "transforms": st.lists(
                st.fixed_dictionaries(
                    {
                        "header": header,
                        "child_frame_id": text,
                        "transform": st.fixed_dictionaries(
                            {
                                "translation": vector,
                                "rotation": st.fixed_dictionaries(dict.fromkeys("xyzw", number)),
                            }
                        ),
                    }
                ),
                max_size=3,
            )
        }
    ),
}


def plain(decoded: Any) -> Any:
    if isinstance(decoded, SimpleNamespace):
        return {name: plain(value) for name, value in vars(decoded).items()}
    if isinstance(decoded, list):
        return [plain(value) for value in decoded]
    return decoded


@pytest.mark.parametrize(("kind", "definition"), [("Image", IMAGE_2), ("TFMessage", TRANSFORMS_2)])
def test_what_another_implementation_of_ros_2_writes_is_read(kind: str, definition: str) -> None:
    from mcap_ros2._dynamic import serialize_dynamic

    write = serialize_dynamic(f"test_msgs/{kind}", definition)[f"test_msgs/{kind}"]

    @given(MESSAGES[kind])
    def reads(message: dict[str, Any]) -> None:
        assert plain(ros_decoder("cdr", kind)(write(message))) == message

    reads()


@given(
    st.binary(max_size=200), st.sampled_from(sorted(DEFINITIONS)), st.sampled_from(["Image", "CameraInfo"])
)
def test_any_bytes_are_a_message_or_end_early(data: bytes, dialect: Any, kind: str) -> None:
    try:
        message = ros_decoder(dialect, kind)(data)
    except ValueError:
        return
    assert set(vars(message)) == {field.name for field in LAYOUTS[dialect][kind]}


def test_lengths_are_not_believed() -> None:
    """Claims of 4 GB, of doubles and of transforms, cost nothing."""
    image = struct.pack("<III", 0, 0, 0) + b"\0\0\0\0" + bytes(8) + b"\0\0\0\0" + b"\0" + bytes(4)
    with pytest.raises(ValueError, match="ends early"):
        ros_decoder("ros1", "Image")(image + b"\xff\xff\xff\xff" + b"abc")
    info = struct.pack("<III", 0, 0, 0) + bytes(16)
    with pytest.raises(ValueError, match="ends early"):
        ros_decoder("ros1", "CameraInfo")(info + b"\xff\xff\xff\xff")
    with pytest.raises(ValueError, match="4294967295 TransformStamped"):
        ros_decoder("ros1", "TFMessage")(b"\xff\xff\xff\xff" + bytes(100))


def test_definitions_as_ros_prints_them_fit() -> None:
    check_definition("ros1", "CameraInfo", CAMERA_INFO_1)
    check_definition("ros1", "CameraInfo", CAMERA_INFO_1.replace("std_msgs/Header header", "Header header"))
    check_definition("cdr", "TFMessage", TRANSFORMS_2)
    check_definition("cdr", "Image", IMAGE_2)
    check_definition("cdr", "CameraInfo", INFO_2)


@pytest.mark.parametrize(
    ("name", "definition"),
    [
        ("Image", "uint8 a"),
        ("Image", ""),
        ("Image", 'string __import__("os").system("id>pwned");X=1\nuint8 a'),
        ("Image", IMAGE_2.replace("uint32 height\nuint32 width", "uint32 width\nuint32 height")),
        ("Image", IMAGE_2.replace("uint8[] data", "uint16[] data")),
        ("Image", IMAGE_2.replace("int32 sec", "int64 sec")),
        ("Image", IMAGE_2.replace("string frame_id", "string frame_id\nuint8 more")),
        ("TFMessage", TRANSFORMS_2.replace("float64 w 1", "float32 w 1")),
        ("CameraInfo", INFO_2.replace("float64[9]  k", "float64[8]  k")),
        ("Image", IMAGE_2 + "#" * limits.DEFINITION_CHARACTERS),
    ],
)
def test_other_definitions_are_told(name: str, definition: str) -> None:
    with pytest.raises(OtherLayoutError):
        check_definition("cdr", name, definition)


def test_constants_defaults_and_comments_are_no_fields() -> None:
    text = "uint8 A=1 # one\n# nothing\n\nstring NAME= x # y\nfloat64 w 1.0 # default\n"
    text += "uint8[<=3] few\nint8[4] four"
    assert parse_fields(text) == (
        Field("w", "float64"),
        Field("few", "uint8", "[]"),
        Field("four", "int8", "[4]"),
    )
