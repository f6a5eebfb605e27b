"""
What the MAVLink source costs: 200 Hz of ODOMETRY and 200 Hz of ATTITUDE over UDP on one machine.

Prints the share of a core that the source takes, what was lost, and after how long odometry is
back when a TCP line has been down for two seconds. Exits 1 above 10 % of a core, a loss or 1 s.
"""

from __future__ import annotations

import argparse
import multiprocessing
import socket
import sys
import time
from typing import Callable

from dlsc_qbs_ros.config import MavlinkConfig, OdometryConfig
from dlsc_qbs_ros.io.mavlink.framing import dialect
from dlsc_qbs_ros.io.mavlink.link import MavlinkLink
from dlsc_qbs_ros.pipeline.odometry import OdometryNormaliser
from mavlink_mutations import attitude, heartbeat, odometry

RATE_HZ = 200
DOWN_S = 2.0  # long enough for the longest wait between two tries
MAX_SHARE = 0.10
MAX_RETURN_S = 1.0


def fly(send: Callable[[bytes], None], began_s: float, duration_s: float) -> None:
    """Send what an autopilot sends that booted at `began_s`, at fixed rates, from now on."""
    sender = dialect.MAVLink(None, 1, 1)
    first = int((time.monotonic() - began_s) * RATE_HZ)
    for k in range(first, first + int(duration_s * RATE_HZ)):
        time.sleep(max(0.0, began_s + k / RATE_HZ - time.monotonic()))
        boot_ns = 1_000_000_000 + k * (1_000_000_000 // RATE_HZ)
        beat = [heartbeat(boot_ns)] if (k - first) % RATE_HZ == 0 else []
        for message in (*beat, odometry(boot_ns), attitude(boot_ns)):
            send(message.pack(sender))
            sender.seq = (sender.seq + 1) % 256


def fly_over_udp(port: int, duration_s: float) -> None:
    """Fly as a process of its own, whose time is not the source's."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        fly(lambda packet: line.sendto(packet, ('127.0.0.1', port)),
            time.monotonic(), duration_s)


def cost(duration_s: float) -> tuple[float, int, dict[str, int]]:
    """Return the share of a core, the samples lost, and what the source says was amiss."""
    port = free_port()
    link = MavlinkLink(MavlinkConfig(connection=f'udpin:127.0.0.1:{port}', rate_hz=RATE_HZ))
    normaliser = OdometryNormaliser(OdometryConfig())
    link.start(normaliser.accept)
    peer = multiprocessing.get_context('spawn').Process(
        target=fly_over_udp, args=(port, duration_s))
    peer.start()
    began_s = time.process_time()
    peer.join()
    share = (time.process_time() - began_s) / duration_s
    link.stop()
    lost = int(duration_s * RATE_HZ) - normaliser.counts['odometry_accepted']
    return share, lost, dict(link.diagnostics())


def seconds_until_back() -> float:
    """Return how long after a TCP line is up again, which was down, odometry is back."""
    arrivals_s: list[float] = []
    port, boot_s = free_port(), time.monotonic()
    link = MavlinkLink(MavlinkConfig(connection=f'tcp:127.0.0.1:{port}'))
    link.start(lambda raw: arrivals_s.append(time.monotonic()))
    fly_over_tcp(port, boot_s)
    time.sleep(DOWN_S)
    up_s = time.monotonic()
    fly_over_tcp(port, boot_s)
    link.stop()
    return min(arrival_s for arrival_s in arrivals_s if arrival_s > up_s) - up_s


def fly_over_tcp(port: int, boot_s: float) -> None:
    """Listen, fly for a second once somebody is there, and hang up."""
    with socket.create_server(('127.0.0.1', port)) as server, server.accept()[0] as line:
        fly(line.sendall, boot_s, 1.0)


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.create_server(('127.0.0.1', 0)) as server:
        return server.getsockname()[1]


def main() -> int:
    """Measure; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seconds', type=float, default=30.0, help='of the flight over UDP')
    share, lost, amiss = cost(parser.parse_args().seconds)
    return_s = seconds_until_back()
    print(f'{100 * share:.1f} % of a core, {lost} samples lost, amiss: {amiss}')
    print(f'odometry is back {return_s:.2f} s after the line')
    return 0 if share <= MAX_SHARE and lost == 0 and return_s <= MAX_RETURN_S else 1


if __name__ == '__main__':
    sys.exit(main())
