"""The encoder node: images in, codes, views and dictionaries out."""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
import sys
import time

from sensor_msgs.msg import CompressedImage, Image

from .encoder_scope import EncoderScope
from ..config import Config
from ..errors import DlscQbsError, ImageError, StampError
from ..pipeline.encoder import Encoded, Encoder
from ..ros.conversions import code_to_msg, dictionary_to_msg, view_to_msg
from ..ros.diagnostics import OK, PERIOD_S, SequenceGaps, WARN, why_silent
from ..ros.image_conversions import frame_from_msg
from ..ros.managed_node import ManagedNode
from ..ros.qos import create_publisher, create_subscription, DICTIONARY, IMAGE_INPUT, OUTPUT
from ..ros.runtime import run_node
from ..ros.stamps import received_ns

PROBLEMS = ('lost', 'refused_malformed', 'refused_out_of_order', 'ran_away')


class EncoderNode(ManagedNode):
    """Feeds every image to the encoder and publishes what comes out, under the image's stamp."""

    def __init__(self):
        super().__init__('encoder', ('image', 'view', 'encoder', 'patches'))

    def configure(self, config: Config, undo: ExitStack) -> None:
        """Make the learner and what it is heard by."""
        self._image_type = CompressedImage if config.image.compressed else Image
        self._encoder = Encoder(config)
        self._gaps = SequenceGaps()
        self._counts: Counter[str] = Counter()
        self._reported: Counter[str] = Counter()
        self._last: Encoded | None = None
        self._dictionary_publisher = create_publisher(self, Image, 'dictionary', DICTIONARY)
        self._view_publisher = create_publisher(self, Image, 'view', OUTPUT)
        self._code_publisher = create_publisher(self, Image, 'code', OUTPUT)
        self._scope = EncoderScope(self, self._encoder)

    def activate(self, undo: ExitStack) -> None:
        """Listen to images."""
        self._gaps.restart()
        self._images = create_subscription(
            self, self._image_type, 'image', self._on_image, IMAGE_INPUT)

    def _on_image(self, msg: Image | CompressedImage, info: dict) -> None:
        self._counts['received'] += 1
        self._gaps.observe(info['publication_sequence_number'])
        try:
            encoded = self._encoder.process(frame_from_msg(msg))
        except ImageError as error:
            self._refuse('malformed', error)
            return
        except StampError as error:
            self._refuse('out_of_order', error)
            return
        self._publish(encoded)
        self._counts['encoded'] += 1
        self._counts['learned'] += encoded.learned
        self._counts['ran_away'] += encoded.ran_away
        self._counts['latency_ns'] += time.time_ns() - received_ns(info)
        self._scope.show(encoded)  # last: nobody waits for it

    def _refuse(self, cause: str, error: DlscQbsError) -> None:
        self._counts[f'refused_{cause}'] += 1
        self.get_logger().warning(f'image refused: {error}', throttle_duration_sec=5.0)

    def _publish(self, encoded: Encoded) -> None:
        if encoded.dictionary is not None:  # before the first code that refers to it
            self._dictionary_publisher.publish(dictionary_to_msg(encoded.dictionary))
        self._view_publisher.publish(view_to_msg(encoded.view))
        self._code_publisher.publish(code_to_msg(encoded.code))
        self._last = encoded

    def report(self) -> tuple[bytes, str, dict[str, object]]:
        """Say how it goes, and what is amiss."""
        self._counts['lost'] = self._gaps.lost
        new = self._counts - self._reported
        self._reported = self._counts.copy()
        encoded = new['encoded']
        values = {key: self._counts[key] for key in (
            'received', 'encoded', 'learned', *PROBLEMS)}
        values['rate_hz'] = encoded / PERIOD_S
        values['latency_ms'] = new['latency_ns'] * 1e-6 / encoded if encoded else 0.0
        values['gate_open_share'] = new['learned'] / encoded if encoded else 0.0
        values['lambda_max'] = self._encoder.lambda_max
        values['lambda_max_limit'] = self._encoder.lambda_max_limit
        if self._last is not None:
            values.update(surprise=self._last.surprise, epoch=self._last.epoch,
                          reprojection_error=self._last.reprojection_error)
        problems = self._problems(new)
        return WARN if problems else OK, ', '.join(problems) or 'encoding', values

    def _problems(self, new: Counter[str]) -> list[str]:
        """Return what is amiss about what is new since the last report, causes first."""
        problems = [f'{new[key]} {key.replace("_", " ")}' for key in PROBLEMS if new[key]]
        if not new['received']:
            problems.insert(0, f'no image: {why_silent(self, self._images)}')
        elif new['refused_out_of_order'] == new['received']:
            problems.insert(0, 'image stamps do not advance')
        lambda_max, limit = self._encoder.lambda_max, self._encoder.lambda_max_limit
        if lambda_max >= limit:  # as it stays where nothing protects the learner
            problems.append(f'lambda_max {lambda_max:.6g} is not below {limit:.6g}')
        return problems


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    return run_node(EncoderNode, args)


if __name__ == '__main__':
    sys.exit(main())
