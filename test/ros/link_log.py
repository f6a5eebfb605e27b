"""A recording of a MAVLink link, as a ground station writes it."""

from dlsc_qbs_ros.io.mavlink.autopilot_messages import odometry
from dlsc_qbs_ros.io.mavlink.framing import dialect


def write_tlog(path, samples, boot_ns):
    """Write odometry of an autopilot that booted at that time, each sample as it was measured."""
    sender = dialect.MAVLink(None, 1, dialect.MAV_COMP_ID_AUTOPILOT1)
    heartbeat = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_PX4, 0, 0, dialect.MAV_STATE_ACTIVE, 3)
    with open(path, 'wb') as file:
        for raw in samples:
            stamp_ns = raw.sample.stamp_ns
            for message in (heartbeat, odometry(raw, stamp_ns - boot_ns)):
                file.write((stamp_ns // 1000).to_bytes(8, 'big') + message.pack(sender))
                sender.seq = (sender.seq + 1) % 256
    return path
