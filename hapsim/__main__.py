"""python -m hapsim"""

from hapsim.cli import main

main()
