# SPDX-License-Identifier: Apache-2.0
"""Parts of one node each; what several share is in `nodes/ros`."""
