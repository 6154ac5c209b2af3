# SPDX-License-Identifier: Apache-2.0
"""The closed loop: controller, offline loop, compiled loop, integration of the plant."""
