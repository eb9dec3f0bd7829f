# %% list_topics, BagTopic
# The notebook bag_to_poses writes such a bag.
from mirrorball.bags import BagTopic, list_topics

topics: list[BagTopic] = list_topics("drive")
print([(topic.name, topic.type, topic.role) for topic in topics])

# %% import_bag, Selection, ImportSummary, ImportedTopic
from pathlib import Path

from mirrorball.bags import ImportedTopic, ImportSummary, Selection, import_bag

Path("recording").mkdir()
summary: ImportSummary = import_bag("drive", "recording", selection=Selection(odometry="/odom"))
first: ImportedTopic = summary.topics[0]
print(first.file, first.rows, summary.warnings)
