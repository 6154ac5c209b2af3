# SPDX-License-Identifier: Apache-2.0
"""The command line: ``dz VERB``, ``dz NOUN VERB``; one verb a file, add_arguments + run."""
