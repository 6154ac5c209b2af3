# SPDX-License-Identifier: Apache-2.0
"""Design of the loop: rules, assumptions, boundary layer, stability margins."""
