"""The node as an ament package; momapos itself comes by pip, see the how-to on ROS 2."""

from setuptools import setup

NAME = "momapos_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools", "momapos"],
    license="Apache-2.0",
    entry_points={"console_scripts": [f"momapos_node = {NAME}.node:main"]},
)
