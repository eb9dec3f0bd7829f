//! Which topics and services does the node read? All of them as one stream of messages.

use std::sync::mpsc::Receiver;

use anyhow::{Result, anyhow};
use futures::channel::oneshot;
use futures::executor::block_on;
use futures::future::{Either, ready, select};
use futures::stream::{LocalBoxStream, SelectAll, StreamExt};
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use ros2_client::{
    Message, MessageInfo, Name, Node, QosProfile, Server, ServiceMapping, ServiceTypeName,
    Subscription,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::super::config::Ros2Config;
use super::super::messages::{
    Image, Imu, Odometry, PoseWithCovarianceStamped, RosType, Twist, TwistStamped,
};
use super::inputs::{Incoming, InputHandler};
use super::publish::{topic_name, type_name};

/// Request of robot_localization/SetPose.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct SetPoseRequest {
    pose: PoseWithCovarianceStamped,
}

/// Its response: DDS has no empty structs.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct SetPoseResponse {
    structure_needs_at_least_one_member: u8,
}

impl Message for SetPoseRequest {}
impl Message for SetPoseResponse {}

/// The subscriptions of the configured topics.
pub(super) struct Subscriptions {
    twist: Option<Subscription<Twist>>,
    twist_stamped: Option<Subscription<TwistStamped>>,
    initial_pose: Option<Subscription<PoseWithCovarianceStamped>>,
    odometry: Option<Subscription<Odometry>>,
    imu: Option<Subscription<Imu>>,
    image: Option<Subscription<Image>>,
    set_pose: Server<SetPoseRequest, SetPoseResponse>,
}

fn subscription<M: RosType + 'static>(
    node: &mut Node,
    config: &Ros2Config,
    topic: &str,
    qos: QosProfile,
) -> Result<Option<Subscription<M>>> {
    if topic.is_empty() {
        return Ok(None);
    }
    let name = topic_name(config, topic)?;
    node.create_topic(&name, type_name::<M>(), &qos)
        .and_then(|created| node.create_subscription(&created, None))
        .map(Some)
        .map_err(|error| anyhow!("[ros2] cannot read {topic}: {error}"))
}

impl Subscriptions {
    pub(super) fn create(node: &mut Node, config: &Ros2Config) -> Result<Self> {
        let topics = &config.inputs;
        // Best effort, because writers of either kind accept it. Of a command the newest counts.
        let newest = QosProfile::subscription_default();
        let every = newest.clone().history(History::KeepLast { depth: 100 });
        let service = QosProfile::publisher_default()
            .reliability(Reliability::Reliable {
                when_full: WhenFull::DEFAULT,
            })
            .durability(Durability::Volatile)
            .history(History::KeepLast { depth: 10 });
        let service_name = Name::parse(&config.absolute(&format!("{}/set_pose", config.node)))
            .map_err(|error| anyhow!("[ros2] invalid node: {error:?}"))?;
        let set_pose = node
            .create_server(
                ServiceMapping::Enhanced,
                &service_name,
                &ServiceTypeName::new("robot_localization", "SetPose"),
                service.clone(),
                service,
            )
            .map_err(|error| anyhow!("[ros2] cannot offer the service set_pose: {error}"))?;
        Ok(Subscriptions {
            twist: subscription(node, config, &topics.cmd_vel, newest.clone())?,
            twist_stamped: subscription(node, config, &topics.cmd_vel_stamped, newest.clone())?,
            initial_pose: subscription(node, config, &topics.initial_pose, every.clone())?,
            odometry: subscription(node, config, &topics.odometry, every.clone())?,
            imu: subscription(node, config, &topics.imu, every)?,
            image: subscription(node, config, &topics.image, newest)?,
            set_pose,
        })
    }

    /// All of them as one stream. What cannot be decoded is left out.
    fn streams(&self) -> SelectAll<LocalBoxStream<'_, Incoming>> {
        fn of<'a, M: DeserializeOwned + 'static>(
            subscription: &'a Option<Subscription<M>>,
            wrap: impl Fn(M, MessageInfo) -> Incoming + 'a,
        ) -> Option<LocalBoxStream<'a, Incoming>> {
            let stream = subscription.as_ref()?.async_stream();
            let taken = stream.filter_map(move |result| {
                ready(result.ok().map(|(message, info)| wrap(message, info)))
            });
            Some(taken.boxed_local())
        }
        let requests = self.set_pose.receive_request_stream().filter_map(|result| {
            ready(
                result
                    .ok()
                    .map(|(id, request)| Incoming::GivenPose(request.pose.pose, Some(id))),
            )
        });
        let streams = [
            of(&self.twist, Incoming::Twist),
            of(&self.twist_stamped, |message, info| {
                Incoming::Twist(message.twist, info)
            }),
            of(&self.initial_pose, |message, _| {
                Incoming::GivenPose(message.pose, None)
            }),
            of(&self.odometry, |message, _| {
                Incoming::Odometry(Box::new(message))
            }),
            of(&self.imu, |message, _| Incoming::Imu(message)),
            of(&self.image, |message, _| Incoming::Image(message)),
            Some(requests.boxed_local()),
        ];
        streams.into_iter().flatten().collect()
    }
}

/// Subscriptions, and what ends when they are to be left.
pub(super) type Joined = (Subscriptions, oneshot::Receiver<()>);

/// Passes what arrives to the handler, of one membership after the other.
pub(super) fn receive_all(memberships: &Receiver<Joined>, mut handler: InputHandler) {
    while let Ok((subscriptions, left)) = memberships.recv() {
        receive(&subscriptions, &mut handler, left);
    }
}

/// Passes what arrives to the handler until `left` ends.
fn receive(
    subscriptions: &Subscriptions,
    handler: &mut InputHandler,
    mut left: oneshot::Receiver<()>,
) {
    let mut streams = subscriptions.streams();
    block_on(async {
        while let Either::Right((Some(incoming), _)) = select(&mut left, streams.next()).await {
            let request = match &incoming {
                Incoming::GivenPose(_, request) => *request,
                _ => None,
            };
            handler.handle(incoming);
            if let Some(id) = request {
                let response = SetPoseResponse {
                    structure_needs_at_least_one_member: 0,
                };
                // A client that is gone gets no response.
                let _sent = subscriptions
                    .set_pose
                    .async_send_response(id, response)
                    .await;
            }
        }
    });
}
