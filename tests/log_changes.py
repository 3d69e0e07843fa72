"""Ways to break a written log folder; each returns a function of the folder."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

IMU_HEAD = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n"
ODOMETER = "shift_042/odometer.csv"


def toml(old: str, new: str):
    """Replace text in log.toml."""

    def change(folder: Path) -> None:
        text = (folder / "log.toml").read_text()
        assert old in text
        (folder / "log.toml").write_text(text.replace(old, new, 1))

    return change


def cell(table: str, row: int, column: str, value: str):
    """Replace one value of a csv table; rows count from 1, as in the errors."""

    def change(folder: Path) -> None:
        path = folder / f"{table}.csv"
        lines = path.read_text().splitlines()
        names = [name.strip('"') for name in lines[0].split(",")]
        values = lines[row].split(",")
        values[names.index(column)] = value
        lines[row] = ",".join(values)
        path.write_text("\n".join(lines) + "\n")

    return change


def header(table: str, old: str, new: str):
    """Rename a column of a csv table."""

    def change(folder: Path) -> None:
        path = folder / f"{table}.csv"
        head, _, rest = path.read_text().partition("\n")
        assert f'"{old}"' in head
        path.write_text(head.replace(f'"{old}"', f'"{new}"') + "\n" + rest)

    return change


def text(name: str, content: str):
    return lambda folder: (folder / name).write_text(content)


def remove(name: str):
    return lambda folder: (folder / name).unlink()


def rename(old: str, new: str):
    return lambda folder: (folder / old).rename(folder / new)


def parquet(table: str, **columns):
    """Replace a csv table by a parquet one."""

    def change(folder: Path) -> None:
        (folder / f"{table}.csv").unlink(missing_ok=True)
        pq.write_table(pa.table(columns), folder / f"{table}.parquet")

    return change
