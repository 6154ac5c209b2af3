# SPDX-License-Identifier: Apache-2.0
"""Microcontrollers on a serial line: framing, protocol, device, driver."""
