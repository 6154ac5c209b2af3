# SPDX-License-Identifier: Apache-2.0
"""A loop in the browser: rows for the page, its server, its assets; no ROS, no file is read."""
