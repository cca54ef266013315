/*
 * KDL's weighted damped least squares as users of Orocos call it: a velocity, without limits.
 */
#include <algorithm>

#include <kdl/chain.hpp>
#include <kdl/chainfksolverpos_recursive.hpp>
#include <kdl/chainiksolvervel_wdls.hpp>

#include "peer.h"

namespace {

constexpr double DAMPING = 0.05; /* as of the plain step */

KDL::Frame placement(const double *rotation, const double *position)
{
    return KDL::Frame(KDL::Rotation(rotation[0], rotation[1], rotation[2], rotation[3], rotation[4],
                                    rotation[5], rotation[6], rotation[7], rotation[8]),
                      KDL::Vector(position[0], position[1], position[2]));
}

KDL::Chain chain_of(const PeerArm &arm)
{
    KDL::Chain chain;
    for (int i = 0; i < arm.joints; i++) {
        const KDL::Frame at = placement(arm.rotation[i], arm.position[i]);
        const KDL::Vector axis(arm.axis[i][0], arm.axis[i][1], arm.axis[i][2]);
        const KDL::Joint::JointType kind =
            arm.prismatic[i] ? KDL::Joint::TransAxis : KDL::Joint::RotAxis;
        const std::string name = "joint_" + std::to_string(i);
        /* A segment's frame is that of the joint at zero, relative to the previous body. */
        chain.addSegment(KDL::Segment(name, KDL::Joint(name, at.p, at.M * axis, kind), at));
    }
    const KDL::Frame tcp = placement(arm.tcp_rotation, arm.tcp_position);
    chain.addSegment(KDL::Segment("tcp", KDL::Joint("tcp", KDL::Joint::Fixed), tcp));
    return chain;
}

struct Peer {
    KDL::Chain chain;
    KDL::ChainFkSolverPos_recursive forward;
    KDL::ChainIkSolverVel_wdls inverse;
    KDL::JntArray q, v;
    KDL::Frame here;

    explicit Peer(const PeerArm &arm)
        : chain(chain_of(arm)), forward(chain), inverse(chain), q(arm.joints), v(arm.joints)
    {
        inverse.setLambda(DAMPING);
        std::copy_n(arm.home, arm.joints, q.data.data());
    }

    void step(const KDL::Frame &goal, double dt)
    {
        forward.JntToCart(q, here);
        inverse.CartToJnt(q, KDL::diff(here, goal, dt), v);
        q.data += v.data * dt;
    }
};

} // namespace

void *peer_create(const PeerArm *arm)
{
    return new Peer(*arm);
}

void peer_destroy(void *peer)
{
    delete static_cast<Peer *>(peer);
}

double peer_step(void *peer, const double *rotation, const double *position, double dt)
{
    const double begin = peer_now();
    static_cast<Peer *>(peer)->step(placement(rotation, position), dt);
    return peer_now() - begin;
}

void peer_joints(const void *peer, double *q)
{
    const Peer *asked = static_cast<const Peer *>(peer);
    std::copy_n(asked->q.data.data(), asked->q.rows(), q);
}
