"""The systems of the thesis, one a file. `python -m systems` lists them, `python -m systems NAME --output DIR` runs one."""
