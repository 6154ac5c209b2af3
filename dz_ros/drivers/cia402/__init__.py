# SPDX-License-Identifier: Apache-2.0
"""Servo drives on CANopen, profile CiA 402 (IEC 61800-7-201), and a simulated one to try it on."""
