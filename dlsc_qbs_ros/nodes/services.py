"""Services of stock types, whose work may take its time."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any, Callable

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import await_or_execute
from rclpy.node import Node
import rclpy.task

from ..errors import DlscQbsError


def offer(node: Node, srv_type: type, name: str, act: Callable) -> None:
    """
    Offer ~/`name`, a Trigger or SetBool, which answers what `act` returns, or why it raises.

    `act` takes what a request holds, if anything. It may be a coroutine that waits for other
    threads with `finished`: all goes on meanwhile, and calls of one service come one by one.
    """
    async def answer(request, response):
        fields = [getattr(request, name) for name in request.get_fields_and_field_types()]
        try:
            response.message = await await_or_execute(act, *fields)
            response.success = True
        except DlscQbsError as error:
            response.message = str(error)
        return response
    node.create_service(srv_type, f'~/{name}', answer,
                        callback_group=MutuallyExclusiveCallbackGroup())


async def finished(node: Node, work: Future) -> Any:
    """Return the result of another thread's work, as soon as it is there, in `node`'s executor."""
    done = rclpy.task.Future()

    def resume(_) -> None:
        done.set_result(None)
        executor = node.executor
        if executor is not None:
            executor.wake()  # it may wait for its next timer
    work.add_done_callback(resume)
    await done
    return work.result()
