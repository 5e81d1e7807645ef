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

    def bag(self, path: Path) -> Path:
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
        with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
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
