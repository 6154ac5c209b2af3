# SPDX-License-Identifier: Apache-2.0
"""Services that outlive every request (ours).

rclpy lets what a service's callback raises end the executor, and with it the node. The parameter
services that it gives every node raise for a value of a type that does not exist, so one request
would end a loop. Here such a request is refused, counted and logged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException

from dz_ros.core.text import LONGEST, printable
from dz_ros.errors import DzRosError

NOT_UNDERSTOOD = 'a request that cannot be understood'
"""Cause by which refused requests are counted."""
Callback = Callable[[Any, Any], Any]


def outliving(srv_type: Any, callback: Callback, refused: Callable[[str], None]) -> Callback:
    """Return a service's callback that no request makes raise.

    Args:
        srv_type: Of the service.
        callback: What it wraps; this package's own errors pass.
        refused: Takes why a request was refused.
    """
    def serve(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except (DzRosError, ExternalShutdownException):
            raise
        except Exception as error:  # noqa: BLE001  whatever a request makes rclpy raise
            why = f'{type(error).__name__}: {" ".join(str(error).split())}'
            refused(why)
            return refusal(srv_type, request, why)

    return serve


def refusal(srv_type: Any, request: Any, why: str) -> Any:
    """Return the response of a service that refuses, with the reason where it has room for one.

    Args:
        srv_type: Of the service.
        request: The request.
        why: The reason.
    """
    response = srv_type.Response()
    reason = printable(f'{NOT_UNDERSTOOD}: {why}', LONGEST)
    if hasattr(response, 'results') and hasattr(request, 'parameters'):
        response.results = [SetParametersResult(reason=reason) for _ in request.parameters]
    elif isinstance(getattr(response, 'result', None), SetParametersResult):
        response.result.reason = reason
    elif hasattr(response, 'message'):
        response.message = reason
    return response
