# SPDX-License-Identifier: Apache-2.0
"""Reports of runs: pictures, sections and pages."""
