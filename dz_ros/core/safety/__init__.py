# SPDX-License-Identifier: Apache-2.0
"""What keeps a loop safe: modes, guards and the command limiter. No clock."""
