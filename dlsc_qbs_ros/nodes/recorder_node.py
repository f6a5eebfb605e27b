"""The recorder node: any topics, as they come over the wire, into one MCAP recording."""

from __future__ import annotations

from concurrent.futures import Future
from contextlib import ExitStack
from datetime import datetime
from functools import partial
from pathlib import Path
import sys
from typing import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from std_srvs.srv import Trigger

from .arrival_clock import ArrivalClock
from .recorder_arguments import parameters_from
from .recorder_files import attachments_of, Repairs
from .recorder_report import RecorderReport
from .recorder_selection import TopicSelection
from .recorder_text import show
from .recorder_topics import RecorderTopics
from .services import finished, offer
from ..config import Config
from ..io.recordings.recording import Recording
from ..ros.diagnostics import PERIOD_S
from ..ros.loss_conversions import losses_to_msg
from ..ros.managed_node import ManagedNode
from ..ros.qos import create_publisher, OUTPUT, qos_to_words
from ..ros.qos_overrides import load_qos_overrides
from ..ros.runtime import run_ros, spin, StopRequest, without_ros_args
from ..ros.serialization import serialize, type_name

POLL_PERIOD_S = 0.02
DISCOVERY_PERIOD_S = 0.1
LINE_PERIOD_S = 0.5


class RecorderNode(ManagedNode):
    """Subscribes to what is chosen as it appears and writes every message unread."""

    def __init__(self, **options):
        super().__init__('recorder', ('recorder',), **options)

    def configure(self, config: Config, undo: ExitStack) -> None:
        """Open the recording."""
        self._losses = create_publisher(self, DiagnosticArray, '~/losses', OUTPUT)
        selection = TopicSelection(
            config.recorder, self.resolve_topic_name, self._losses.topic_name)
        overrides = load_qos_overrides(config.recorder.qos_profile_overrides_path)
        attachments = attachments_of(config)
        directory = Path(
            config.recorder.output or f'recording_{datetime.now():%Y_%m_%d-%H_%M_%S}')
        self._recording = Recording(directory, config.recorder, lambda: self._topics.missed())
        self._topics = RecorderTopics(self, self._recording, selection, overrides)
        self._arrivals = ArrivalClock(self.get_clock())
        self._is_paused = config.recorder.start_paused
        self._told_losses: dict[str, dict[str, object]] = {}
        self._told_error = ''
        repairs = Repairs(directory.parent)
        self._report = RecorderReport(self._recording, self._topics, repairs)
        undo.callback(repairs.stop)  # last: it may take long
        undo.callback(self._finish)
        for attachment in attachments:
            self._recording.attach(*attachment)
        for name, act, answer in (
                ('pause', lambda: self._pause(True), 'paused'),
                ('resume', lambda: self._pause(False), 'resumed'),
                ('split', self._recording.split, 'the next message begins a file'),
                ('snapshot', self._recording.snapshot, 'written')):
            offer(self, Trigger, name, partial(self._serve, act, answer))
        self.get_logger().info(f'recording into {directory}')

    def activate(self, undo: ExitStack) -> None:
        """Listen to what there is, look for more, and tell how it goes."""
        undo.callback(self._topics.leave)
        undo.callback(self._record)
        timers = [(POLL_PERIOD_S, self._record), (DISCOVERY_PERIOD_S, self._discover),
                  (PERIOD_S, self._tell)]
        if sys.stderr.isatty():
            timers.append((LINE_PERIOD_S, lambda: show(self._report.line(self._is_paused))))
        for period_s, callback in timers:
            self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _pause(self, is_paused: bool) -> None:
        self._is_paused = is_paused

    async def _serve(self, act: Callable[[], Future | None], answer: str) -> str:
        """Do something after what has arrived by now; answer when it is done."""
        self._record()
        work = act()
        if work is not None:
            await finished(self, work)
        return answer

    def _discover(self) -> None:
        if not self._is_waiting_for_clock():
            self._topics.discover()

    def _is_waiting_for_clock(self) -> bool:
        """Tell whether log times would lie before the simulated clock's first tick."""
        return self.get_clock().ros_time_is_active and self.get_clock().now().nanoseconds == 0

    def _record(self) -> None:
        """Write what has arrived."""
        self._arrivals.tick()
        for arrival in self._topics.take():
            if not self._is_paused:
                self._recording.write(
                    arrival.topic, arrival.data, self._arrivals.time_ns(arrival),
                    arrival.info['source_timestamp'],
                    arrival.info['publication_sequence_number'] or 0)

    def _tell(self) -> None:
        """Put new losses on a topic, in the recording too; tell once when the recording ended."""
        status = self._recording.status()
        losses = {topic: losses.values()
                  for topic, losses in self._topics.losses(status).items() if losses.total}
        if losses != self._told_losses:
            now_ns = self.get_clock().now().nanoseconds
            msg = losses_to_msg(now_ns, losses)
            self._losses.publish(msg)
            topic = self._losses.topic_name
            has_ended = status.state == 'stopped'  # only who listens can be told then
            if not self._told_losses and not has_ended:
                self._recording.add_topic(topic, type_name(msg), [qos_to_words(OUTPUT)])
            if has_ended or self._recording.write(topic, serialize(msg), now_ns, now_ns):
                self._told_losses = losses
        if status.error and status.error != self._told_error:
            consequence = 'nothing more is recorded: ' * (status.state == 'stopped')
            self.get_logger().error(f'{consequence}{status.error}')
        self._told_error = status.error

    def _finish(self) -> None:
        """Finish the recording and print what it holds; raise RecordingError if not whole."""
        self._tell()
        try:
            self._recording.close()
        finally:
            print(self._report.summary(), flush=True)

    def report(self) -> tuple[bytes, str, dict[str, object]]:
        """Say how it goes, what is missing and what is waited for."""
        awaited = ['/clock'] if self._is_waiting_for_clock() else self._topics.awaited()
        return self._report.diagnostics(awaited, self._is_paused)


def main(args: Sequence[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM; return the exit code, 1 when a message was not written."""
    argv = list(sys.argv[1:] if args is None else args)
    parameters = parameters_from(without_ros_args(argv))

    def work(stop: StopRequest) -> None:
        spin(RecorderNode(parameter_overrides=parameters), stop)
    return run_ros(work, args)


if __name__ == '__main__':
    sys.exit(main())
