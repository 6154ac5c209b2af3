# SPDX-License-Identifier: Apache-2.0
"""Where a command goes: the simulated actuator and plant."""
