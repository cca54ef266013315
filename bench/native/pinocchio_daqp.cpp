/*
 * A step of differential inverse kinematics in C++: Pinocchio's Jacobian, and a quadratic program
 * within the joints' limits of position, speed and acceleration, which daqp solves with a warm
 * start. Task and limits are those of pink's frame task. With pairs of bodies, Coal's distance of
 * each, and a row for those that could come too near in a step, selected and limited as in
 * cardan/gateway/servo/servo.py.
 */
#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include <coal/shape/geometric_shapes.h>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/geometry.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/collision/distance.hpp>
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
constexpr int MOST_ROWS = 16;
constexpr double TIGHT_M_S = 1e-4; /* a row that leaves more than this cannot act */

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

std::shared_ptr<coal::ShapeBase> geometry(const PeerShape &shape)
{
    const double *size = shape.size;
    switch (shape.kind) {
    case PEER_CAPSULE:
        return std::make_shared<coal::Capsule>(size[0], size[1]);
    case PEER_SPHERE:
        return std::make_shared<coal::Sphere>(size[0]);
    default:
        return std::make_shared<coal::Box>(size[0], size[1], size[2]);
    }
}

double stopping_speed(double distance, double acceleration, double dt)
{
    if (!(distance > 0.0))
        return 0.0;
    const double gain = acceleration * dt;
    return std::sqrt(gain * gain + 2.0 * acceleration * distance) - gain;
}

struct Row {
    double room, least;
    Vector gradient;
};

struct Peer {
    PeerArm arm;
    pinocchio::Model model;
    pinocchio::Data data;
    pinocchio::FrameIndex tcp;
    Eigen::VectorXd q;
    Vector v, linear;
    Eigen::Matrix<double, 6, 1> weights;
    Eigen::VectorXd lowest, highest; /* of the joints, then of the rows */
    Matrix jacobian, weighted;
    Square hessian;
    pinocchio::GeometryModel bodies;
    pinocchio::GeometryData separations;
    std::vector<PeerPair> pairs;
    std::vector<Row> rows;
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> normals;
    std::vector<int> sense;
    double multipliers[PEER_JOINTS + MOST_ROWS], solution[PEER_JOINTS];
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
        v = linear = Vector::Zero(n);
        weights = Eigen::Map<const Vector6>(arm.weights);
        weights.tail<3>() *= ROTATION_COST;
        lowest = Eigen::VectorXd::Zero(n + MOST_ROWS);
        highest = Eigen::VectorXd::Constant(n + MOST_ROWS, DAQP_INF);
        jacobian = weighted = Matrix::Zero(6, n);
        hessian = Square::Identity(n, n);
        normals.setZero(MOST_ROWS, n);
        sense.assign(n + MOST_ROWS, DAQP_SOFT);
        std::fill_n(sense.begin(), n, 0);
        bound(1e-3);
        problem = DAQPProblem();
        problem.n = problem.ms = n;
        problem.m = n + MOST_ROWS;
        problem.H = hessian.data();
        problem.f = linear.data();
        problem.A = normals.data();
        problem.sense = sense.data();
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

    /* Limits of the joint speeds in the next step; a joint beyond its range returns. */
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

    void surround(const PeerShape *shapes, int shape_count, const PeerPair *given, int pair_count)
    {
        bodies = pinocchio::GeometryModel();
        for (int i = 0; i < shape_count; i++) {
            const PeerShape &shape = shapes[i];
            bodies.addGeometryObject(pinocchio::GeometryObject(
                "shape_" + std::to_string(i), pinocchio::JointIndex(shape.body),
                placement(shape.rotation, shape.position), geometry(shape)));
        }
        pairs.assign(given, given + pair_count);
        for (const PeerPair &pair : pairs)
            bodies.addCollisionPair(pinocchio::CollisionPair(pair.first, pair.second));
        separations = pinocchio::GeometryData(bodies);
        for (coal::DistanceRequest &request : separations.distanceRequests)
            request.enable_signed_distance = true;
        rows.reserve(pairs.size());
    }

    /* Derivative of a pair's distance by each joint speed: both nearest points are on the normal. */
    void differentiate(const PeerPair &pair, const coal::DistanceResult &found, Vector &gradient) const
    {
        const Eigen::Vector3d &point = found.nearest_points[1];
        const Eigen::Vector3d moment = point.cross(found.normal);
        const auto first = bodies.geometryObjects[pair.first].parentJoint;
        const auto second = bodies.geometryObjects[pair.second].parentJoint;
        gradient.setZero(arm.joints);
        for (auto i = first; i < second; i++)
            gradient[i] = data.J.col(i).head<3>().dot(found.normal) +
                          data.J.col(i).tail<3>().dot(moment);
    }

    void add_rows(double dt)
    {
        const int n = arm.joints;
        rows.clear();
        if (!pairs.empty()) {
            pinocchio::updateGeometryPlacements(model, data, bodies, separations);
            pinocchio::computeDistances(bodies, separations);
        }
        const Vector fastest = highest.head(n).cwiseMax(-lowest.head(n));
        for (std::size_t i = 0; i < pairs.size(); i++) {
            const PeerPair &pair = pairs[i];
            const coal::DistanceResult &found = separations.distanceResults[i];
            const double closing =
                Eigen::Map<const Vector>(pair.sweep, n).dot(fastest) + TIGHT_M_S;
            const double stop = closing * (closing / (2.0 * pair.deceleration_m_s2) + dt);
            if (found.min_distance >= pair.safety_m + stop)
                continue;
            Row row;
            differentiate(pair, found, row.gradient);
            row.least =
                -stopping_speed(found.min_distance - pair.safety_m, pair.deceleration_m_s2, dt);
            row.room = row.gradient.cwiseMax(0.0).dot(lowest.head(n)) +
                       row.gradient.cwiseMin(0.0).dot(highest.head(n)) - row.least;
            if (row.room < TIGHT_M_S)
                rows.push_back(row);
        }
        if (rows.size() > MOST_ROWS) {
            std::nth_element(rows.begin(), rows.begin() + MOST_ROWS, rows.end(),
                             [](const Row &a, const Row &b) { return a.room < b.room; });
            rows.resize(MOST_ROWS);
        }
        for (std::size_t i = 0; i < rows.size(); i++) {
            normals.row(i) = rows[i].gradient.transpose();
            lowest[n + i] = rows[i].least;
        }
        problem.m = n + int(rows.size());
        /* The rows may belong to other pairs than before: no constraint is known to be active. */
        std::fill_n(work.sense + n, MOST_ROWS, DAQP_SOFT);
    }

    void step(const pinocchio::SE3 &goal, double dt)
    {
        pinocchio::computeJointJacobians(model, data, q);
        pinocchio::updateFramePlacement(model, data, tcp);
        jacobian.setZero();
        pinocchio::getFrameJacobian(model, data, tcp, pinocchio::LOCAL, jacobian);
        Vector6 error = pinocchio::log6(data.oMf[tcp].actInv(goal)).toVector() / dt;
        weighted = weights.asDiagonal() * jacobian;
        error = weights.cwiseProduct(error);
        hessian.noalias() = weighted.transpose() * weighted;
        hessian.diagonal().array() += DAMPING;
        linear.noalias() = -weighted.transpose() * error;
        bound(dt);
        add_rows(dt);
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

void peer_surround(void *peer, const PeerShape *shapes, int32_t shape_count, const PeerPair *pairs,
                   int32_t pair_count)
{
    static_cast<Peer *>(peer)->surround(shapes, shape_count, pairs, pair_count);
}

void peer_distances(const void *peer, double *distances)
{
    for (const coal::DistanceResult &found : static_cast<const Peer *>(peer)->separations.distanceResults)
        *distances++ = found.min_distance;
}

int32_t peer_rows(const void *peer)
{
    return int32_t(static_cast<const Peer *>(peer)->rows.size());
}
