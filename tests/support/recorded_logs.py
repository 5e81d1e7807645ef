"""Logs of a drive that the libraries of their formats write, with what goes wrong in real ones."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

EPOCH = 1_764_288_000_000_000_000
"""Nanoseconds of the first sample: a date of 2025."""


@dataclass
class Drive:
    """A gap at 20 Hz and a speed at 50 Hz, both of which jitter; the gap loses samples.

    Args:
        seed: Of the jitter.
        lost: First and last second without a gap.
    """

    seed: int = 0
    lost: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        random = np.random.default_rng(self.seed)
        self.gap_at = np.arange(0, 10, 0.05) + random.uniform(0, 0.004, 200)
        if self.lost is not None:
            keep = (self.gap_at <= self.lost[0]) | (self.gap_at >= self.lost[1])
            self.gap_at = self.gap_at[keep]
        self.speed_at = np.arange(0, 10, 0.02) + random.uniform(0, 0.002, 500)
        self.gap = 10 + 5 * np.sin(self.gap_at)
        self.speed = 14 + 0.1 * self.speed_at

    def nanoseconds(self, at: np.ndarray) -> list[int]:
        """Stamps as a recorder writes them."""
        return [EPOCH + round(second * 1e9) for second in at]

    def csv(self, path: Path, unit: str = "m") -> Path:
        """A table of the gap, with stamps in nanoseconds."""
        lines = [f"timestamp,gap [{unit}]"]
        stamps = self.nanoseconds(self.gap_at)
        lines += [f"{at},{gap!r}" for at, gap in zip(stamps, self.gap.tolist(), strict=True)]
        path.write_text("\n".join(lines) + "\n")
        return path

    def mcap(self, path: Path, *, header_offset: int = 0) -> Path:
        """Two topics of JSON messages, written by the library mcap."""
        from mcap.writer import Writer

        stream = io.BytesIO()
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("Any", "jsonschema", b'{"type": "object"}')
        channels = {
            name: writer.register_channel(name, "json", schema) for name in ("/radar", "/odom")
        }
        given = [("/radar", "range", self.gap_at, self.gap)]
        given += [("/odom", "speed", self.speed_at, self.speed)]
        for topic, field, at, values in given:
            offset = header_offset if topic == "/radar" else 0
            for stamp, value in zip(self.nanoseconds(at), values.tolist(), strict=True):
                own = stamp + offset
                header = {"stamp": {"sec": own // 10**9, "nanosec": own % 10**9}}
                data = {"header": header, field: value, "frame": "base"}
                writer.add_message(channels[topic], stamp, json.dumps(data).encode(), stamp)
        writer.finish()
        path.write_bytes(stream.getvalue())
        return path

    def bag(self, path: Path, storage: str = "SQLITE3") -> Path:
        """Two topics of ROS 2 messages in a bag of the library rosbags."""
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_HUMBLE)
        number = store.types["std_msgs/msg/Float64"]
        stamped = store.types["geometry_msgs/msg/TwistStamped"]
        head, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
        twist, vector = (
            store.types["geometry_msgs/msg/Twist"],
            store.types["geometry_msgs/msg/Vector3"],
        )
        with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
            gap = writer.add_connection("/gap", number.__msgtype__, typestore=store)
            odom = writer.add_connection("/odom", stamped.__msgtype__, typestore=store)
            for at, value in zip(self.nanoseconds(self.gap_at), self.gap.tolist(), strict=True):
                raw = store.serialize_cdr(number(data=value), number.__msgtype__)
                writer.write(gap, at, raw)
            for at, value in zip(self.nanoseconds(self.speed_at), self.speed.tolist(), strict=True):
                message = stamped(
                    header=head(stamp=stamp(sec=at // 10**9, nanosec=at % 10**9), frame_id="base"),
                    twist=twist(
                        linear=vector(x=value * 0.6, y=value * 0.8, z=0.0),
                        angular=vector(x=0.0, y=0.0, z=0.0),
                    ),
                )
                writer.write(odom, at, store.serialize_cdr(message, stamped.__msgtype__))
        return path

    def ros2_mcap(self, path: Path) -> Path:
        """Two topics of ROS 2 messages in MCAP, written by the library mcap-ros2-support."""
        from mcap_ros2.writer import Writer

        stamp = "================\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        header = "================\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n"
        header += "string frame_id\n"
        with path.open("wb") as stream:
            writer = Writer(stream)
            radar = writer.register_msgdef(
                "radar_msgs/msg/Range", f"std_msgs/Header header\nfloat64 range\n{header}{stamp}"
            )
            speed = writer.register_msgdef("std_msgs/msg/Float64", "float64 data\n")
            for at, value in zip(self.nanoseconds(self.gap_at), self.gap.tolist(), strict=True):
                stamped = {"stamp": {"sec": at // 10**9, "nanosec": at % 10**9}, "frame_id": "base"}
                message = {"header": stamped, "range": value}
                writer.write_message("/radar", radar, message, log_time=at, publish_time=at)
            for at, value in zip(self.nanoseconds(self.speed_at), self.speed.tolist(), strict=True):
                writer.write_message("/odom", speed, {"data": value}, log_time=at, publish_time=at)
            writer.finish()
        return path

    def protobuf_mcap(self, path: Path) -> Path:
        """Two topics of protobuf messages in MCAP, written by mcap-protobuf-support."""
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
        from mcap_protobuf.writer import Writer

        file = descriptor_pb2.FileDescriptorProto(name="drive.proto", package="drive")
        file.syntax = "proto3"
        file.dependency.append("google/protobuf/timestamp.proto")
        kind = file.message_type.add(name="Sample")
        field = descriptor_pb2.FieldDescriptorProto
        kind.field.add(
            name="timestamp", number=1, type=field.TYPE_MESSAGE, label=field.LABEL_OPTIONAL,
            type_name=".google.protobuf.Timestamp",
        )  # fmt: skip
        for number, name in ((2, "value"), (3, "frame")):
            of = field.TYPE_DOUBLE if name == "value" else field.TYPE_STRING
            kind.field.add(name=name, number=number, type=of, label=field.LABEL_OPTIONAL)
        pool = descriptor_pool.DescriptorPool()
        known = descriptor_pb2.FileDescriptorProto()
        timestamp_pb2.DESCRIPTOR.CopyToProto(known)
        pool.Add(known)
        pool.Add(file)
        sample = message_factory.GetMessageClass(pool.FindMessageTypeByName("drive.Sample"))
        with path.open("wb") as stream, Writer(stream) as writer:
            for topic, moments, values in (
                ("/radar", self.gap_at, self.gap), ("/odom", self.speed_at, self.speed),
            ):  # fmt: skip
                for at, value in zip(self.nanoseconds(moments), values.tolist(), strict=True):
                    message = sample(value=value, frame="base")
                    message.timestamp.seconds, message.timestamp.nanos = divmod(at, 10**9)
                    writer.write_message(topic, message, log_time=at, publish_time=at)
        return path

    def ros1_bag(self, path: Path) -> Path:
        """Two topics of ROS 1 messages in a bag of the library rosbags."""
        from rosbags.rosbag1 import Writer
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS1_NOETIC)
        number = store.types["std_msgs/msg/Float64"]
        with Writer(path) as writer:
            for topic, moments, values in (
                ("/radar", self.gap_at, self.gap), ("/odom", self.speed_at, self.speed),
            ):  # fmt: skip
                connection = writer.add_connection(topic, number.__msgtype__, typestore=store)
                for at, value in zip(self.nanoseconds(moments), values.tolist(), strict=True):
                    raw = store.serialize_ros1(number(data=value), number.__msgtype__)
                    writer.write(connection, at, raw)
        return path

    def parquet(self, path: Path) -> Path:
        """A table of the gap in Parquet, with dates as stamps."""
        import pyarrow as pa
        from pyarrow import parquet

        stamps = pa.array(self.nanoseconds(self.gap_at), pa.timestamp("ns"))
        table = pa.table({"timestamp": stamps, "radar": [{"range": each} for each in self.gap]})
        parquet.write_table(table, path, row_group_size=60)
        return path

    def mdf4(self, path: Path) -> Path:
        """Two groups of channels in MDF 4, written by the library asammdf."""
        import asammdf

        measurement = asammdf.MDF(version="4.10")
        for at, values, name, unit in (
            (self.gap_at, self.gap, "range", "m"),
            (self.speed_at, self.speed * 3.6, "speed", "km/h"),
        ):
            given = {"samples": values, "timestamps": at, "name": name, "unit": unit}
            measurement.append([asammdf.Signal(**given)])
        return Path(measurement.save(path))
