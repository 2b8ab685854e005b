# SPDX-License-Identifier: Apache-2.0
"""`python3 -m groundlock --version`: which build of the client is installed."""
import argparse

from ._build import BUILD

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python3 -m groundlock",
        description="The Python client of a Groundlock server, to be imported; `groundlock` is its command line.",
    )
    parser.add_argument("--version", action="version", version=BUILD)
    parser.parse_args()
    parser.print_help()
