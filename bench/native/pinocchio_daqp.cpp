/*
 * A step of differential inverse kinematics as it is written in C++: Pinocchio's Jacobian, and a
 * quadratic programme inside the joints' limits of position, speed and acceleration, which daqp
 * solves from where it was. The same task and limits as pink's frame task; no distances.
 */
#include <algorithm>

#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/spatial.hpp>

extern "C" {
#include "api.h"
#include "utils.h"
}
#include "peer.h"

namespace {

using Matrix = Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, PEER_JOINTS>;
using Square =
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, PEER_JOINTS, PEER_JOINTS>;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, PEER_JOINTS, 1>;
using Rows = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

constexpr double ALIGNED = 1.0 - 1e-12; /* joints about x, y and z cost less than others */
constexpr double ROTATION_COST = 0.3, DAMPING = 1e-4;

pinocchio::SE3 placement(const double *rotation, const double *position)
{
    return pinocchio::SE3(Eigen::Map<const Rows>(rotation),
                          Eigen::Map<const Eigen::Vector3d>(position));
}

pinocchio::JointModel joint(bool prismatic, const Eigen::Vector3d &axis)
{
    if (prismatic)
        return pinocchio::JointModelPrismaticUnaligned(axis);
    if (axis[0] > ALIGNED)
        return pinocchio::JointModelRX();
    if (axis[1] > ALIGNED)
        return pinocchio::JointModelRY();
    if (axis[2] > ALIGNED)
        return pinocchio::JointModelRZ();
    return pinocchio::JointModelRevoluteUnaligned(axis);
}

struct Peer {
    PeerArm arm;
    pinocchio::Model model;
    pinocchio::Data data;
    pinocchio::FrameIndex tcp;
    Eigen::VectorXd q;
    Vector v, linear, lowest, highest;
    Matrix jacobian, weighted;
    Square hessian;
    double multipliers[2 * PEER_JOINTS], solution[PEER_JOINTS];
    DAQPWorkspace work;
    DAQPProblem problem;
    DAQPResult result;

    explicit Peer(const PeerArm &given) : arm(given)
    {
        const int n = arm.joints;
        pinocchio::JointIndex parent = 0;
        for (int i = 0; i < n; i++) {
            const Eigen::Vector3d axis(arm.axis[i]);
            parent = model.addJoint(parent, joint(arm.prismatic[i], axis),
                                    placement(arm.rotation[i], arm.position[i]),
                                    "joint_" + std::to_string(i));
        }
        tcp = model.addFrame(pinocchio::Frame(
            "tcp", parent, 0, placement(arm.tcp_rotation, arm.tcp_position), pinocchio::OP_FRAME));
        data = pinocchio::Data(model);
        q = Eigen::Map<const Vector>(arm.home, n);
        v = linear = lowest = highest = Vector::Zero(n);
        jacobian = weighted = Matrix::Zero(6, n);
        hessian = Square::Identity(n, n);
        bound(1e-3);
        problem = DAQPProblem();
        problem.n = problem.m = problem.ms = n;
        problem.H = hessian.data();
        problem.f = linear.data();
        problem.bupper = highest.data();
        problem.blower = lowest.data();
        work = DAQPWorkspace();
        result = DAQPResult();
        result.x = solution;
        result.lam = multipliers;
        double took = 0.0;
        good = setup_daqp(&problem, &work, &took) >= 0;
    }

    ~Peer()
    {
        free_daqp_workspace(&work);
        free_daqp_ldp(&work);
    }

    /* Speeds of the joints that the next step may have; a joint beyond its range comes back. */
    void bound(double dt)
    {
        for (int i = 0; i < arm.joints; i++) {
            const double change = arm.acceleration[i] * dt;
            const double low = std::max({-arm.velocity[i], v[i] - change, (arm.lower[i] - q[i]) / dt});
            const double high = std::min({arm.velocity[i], v[i] + change, (arm.upper[i] - q[i]) / dt});
            lowest[i] = std::min(low, high);
            highest[i] = std::max(low, high);
        }
    }

    void step(const pinocchio::SE3 &goal, double dt)
    {
        pinocchio::computeJointJacobians(model, data, q);
        pinocchio::updateFramePlacement(model, data, tcp);
        jacobian.setZero();
        pinocchio::getFrameJacobian(model, data, tcp, pinocchio::LOCAL, jacobian);
        Vector6 error = pinocchio::log6(data.oMf[tcp].actInv(goal)).toVector() / dt;
        weighted = jacobian;
        weighted.bottomRows<3>() *= ROTATION_COST;
        error.tail<3>() *= ROTATION_COST;
        hessian.noalias() = weighted.transpose() * weighted;
        hessian.diagonal().array() += DAMPING;
        linear.noalias() = -weighted.transpose() * error;
        bound(dt);
        const int all = DAQP_UPDATE_Rinv | DAQP_UPDATE_M | DAQP_UPDATE_v | DAQP_UPDATE_d;
        result.exitflag = daqp_update_ldp(all, &work, &problem);
        if (result.exitflag >= 0)
            daqp_solve(&result, &work);
        if (result.exitflag > 0)
            v = Eigen::Map<const Vector>(solution, arm.joints);
        else
            v.setZero();
        q += v * dt;
    }

    bool good;
};

} // namespace

void *peer_create(const PeerArm *arm)
{
    Peer *peer = new Peer(*arm);
    if (peer->good)
        return peer;
    delete peer;
    return nullptr;
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
    std::copy_n(asked->q.data(), asked->arm.joints, q);
}
