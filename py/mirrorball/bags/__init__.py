"""ROS bags as recording folders.

    from mirrorball.bags import Selection, import_bag, list_topics

    for topic in list_topics("drive.mcap"):
        print(topic.name, topic.type, topic.role)
    print(import_bag("drive.mcap", "drive/", selection=Selection(image="/omni/image_raw")))

Reads ROS 1 `.bag` files and ROS 2 bags (`.mcap`, `.db3`, or the folder of both) without ROS. Needs
`pip install mirrorball[bags]`. `mirrorball import` does the same from the command line.
"""

from mirrorball.bags.importing import ImportedTopic, ImportSummary, import_bag
from mirrorball.bags.topics import BagTopic, Selection, list_topics

__all__ = ["BagTopic", "ImportSummary", "ImportedTopic", "Selection", "import_bag", "list_topics"]


def __dir__() -> list[str]:
    return __all__
