# SPDX-License-Identifier: Apache-2.0
"""Finding a dead-zone: moves that show it, bounds that hold it, a configuration that uses them."""
