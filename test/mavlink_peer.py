"""An autopilot's side of a link for tests: packets made by pymavlink's own encoder."""

from math import nan
import socket
import time

from pymavlink.dialects.v20 import ardupilotmega as dialect

UNKNOWN = [nan] + [0.0] * 20
TIMEOUT_S = 10.0


class Peer:
    """Packs messages with rising sequence numbers, signed where there is a key."""

    def __init__(self, system=1, component=1, key=None, timestamp=2 ** 46):
        self.mav = dialect.MAVLink(None, system, component)
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.sign_outgoing = True
            self.mav.signing.timestamp = timestamp

    def pack(self, message, **options):
        packet = message.pack(self.mav, **options)
        self.mav.seq = (self.mav.seq + 1) % 256
        return packet


def heartbeat(autopilot=dialect.MAV_AUTOPILOT_PX4, vehicle=dialect.MAV_TYPE_QUADROTOR):
    return dialect.MAVLink_heartbeat_message(
        vehicle, autopilot, 0, 0, dialect.MAV_STATE_ACTIVE, 3)


def odometry(time_s, x=0.0, y=0.0, z=0.0, q=(1.0, 0.0, 0.0, 0.0), **fields):
    """Return ODOMETRY in LOCAL_NED and BODY_FRD, or as the fields say."""
    values = {
        'frame_id': dialect.MAV_FRAME_LOCAL_NED, 'child_frame_id': dialect.MAV_FRAME_BODY_FRD,
        'vx': 0.0, 'vy': 0.0, 'vz': 0.0, 'rollspeed': 0.0, 'pitchspeed': 0.0, 'yawspeed': 0.0,
        'pose_covariance': UNKNOWN, 'velocity_covariance': UNKNOWN, 'reset_counter': 0,
        'quality': 0, **fields}
    return dialect.MAVLink_odometry_message(
        round(time_s * 1e6), x=x, y=y, z=z, q=list(q), estimator_type=0, **values)


def position(time_s, x=0.0, y=0.0, z=0.0, vx=0.0, vy=0.0, vz=0.0):
    return dialect.MAVLink_local_position_ned_message(
        round(time_s * 1e3), x, y, z, vx, vy, vz)


def attitude(time_s, roll=0.0, pitch=0.0, yaw=0.0, yawspeed=0.0):
    return dialect.MAVLink_attitude_message(
        round(time_s * 1e3), roll, pitch, yaw, 0.0, 0.0, yawspeed)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(('127.0.0.1', 0))
        return udp.getsockname()[1]


def wait_until(condition):
    """Wait until the condition holds; fail when it never does."""
    until_s = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < until_s, 'waited in vain'
        time.sleep(0.005)
