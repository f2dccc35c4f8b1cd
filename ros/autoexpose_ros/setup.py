"""For colcon."""

from pathlib import Path

from setuptools import setup

NAME = "autoexpose_ros"

setup(
    name=NAME,
    version="1.0.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", [str(file) for file in Path("launch").glob("*.launch.py")]),
        (f"share/{NAME}/config", [str(file) for file in Path("config").glob("*.yaml")]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The autoexpose-daemon authors",
    maintainer_email="nobody@autoexpose-daemon.invalid",
    description="The cameras of an autoexpose daemon as a lifecycle node.",
    license="MIT",
    entry_points={"console_scripts": [f"rig = {NAME}.rig_node:main"]},
)
